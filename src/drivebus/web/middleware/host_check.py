"""Check of the Host and Origin headers.

A foreign page reaches this service through a browser in two ways: across origins, which ``Origin`` shows, and by DNS
rebinding (its own name resolves to this machine), which ``Host`` shows. A numeric address cannot be rebound.
"""

from __future__ import annotations

import ipaddress
import re
import socket
from urllib.parse import urlsplit

from starlette.datastructures import Headers

from drivebus.web.gateway import WebConfig

_LOCAL_NAMES = frozenset({"localhost"})
_HOST = re.compile(r"(?:\[([0-9A-Fa-f:.]+)\]|([A-Za-z0-9._-]+))(?::\d{1,5})?")
"""Host header: a name or an address, and a port. Anything else has a second meaning for another parser."""


class HostCheck:
    """Names and origins of one service."""

    def __init__(self, web: WebConfig) -> None:
        self._origins = {origin.rstrip("/").lower() for origin in web.origins}
        proxies = {urlsplit(origin).hostname or "" for origin in self._origins}
        self._authorities = {urlsplit(origin).netloc for origin in self._origins}
        self._tls_origins = {origin for origin in self._origins if origin.startswith("https://")}
        self._tls_authorities = {urlsplit(origin).netloc for origin in self._tls_origins}
        self._names = _LOCAL_NAMES | {web.host.lower(), socket.gethostname().lower()} | proxies

    def is_known_host(self, headers: Headers) -> bool:
        """Return whether there is one Host header, with a name of this service or a numeric address."""
        hosts = headers.getlist("host")
        host = _HOST.fullmatch(hosts[0]) if len(hosts) == 1 else None
        name = (host[1] or host[2]).lower() if host is not None else ""
        return name in self._names or _is_address(name)

    def is_allowed_origin(self, headers: Headers, scheme: str) -> bool:
        """Return whether there is one Origin: this service as the browser addressed it, or a configured one.

        Where the origin of a host is configured, no other scheme is accepted for it: behind a proxy with TLS, a page
        that was loaded over HTTP may be a foreign one.
        """
        origins = headers.getlist("origin")
        if len(origins) != 1:
            return False
        origin, host = origins[0].lower(), headers["host"].lower()
        http_scheme = {"ws": "http", "wss": "https"}.get(scheme, scheme)
        return origin in self._origins or (origin == f"{http_scheme}://{host}" and host not in self._authorities)

    def uses_tls(self, headers: Headers, scheme: str) -> bool:
        """Return whether the browser uses TLS: to this service, or to a reverse proxy whose origin is configured.

        Not every request has an Origin, and not every proxy passes the Host on.
        """
        return (
            scheme in ("https", "wss")
            or headers.get("host", "").lower() in self._tls_authorities
            or headers.get("origin", "").lower() in self._tls_origins
        )


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
