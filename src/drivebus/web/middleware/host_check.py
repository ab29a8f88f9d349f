"""Which Host a request may name, and from which Origin it may come (S03, S04).

A page of somebody else reaches this service through a browser in two ways: across origins, told by ``Origin``, and by
a name of its own that it lets point here (DNS rebinding), told by ``Host``. An address in digits is nobody's name.
"""

from __future__ import annotations

import ipaddress
import socket
from urllib.parse import urlsplit

from starlette.datastructures import Headers

from drivebus.service.config.model import WebConfig

_LOCAL_NAMES = frozenset({"localhost"})


class HostCheck:
    """The names and origins of one service."""

    def __init__(self, web: WebConfig) -> None:
        self._origins = {origin.rstrip("/").lower() for origin in web.origins}
        beyond = {urlsplit(origin).hostname or "" for origin in self._origins}
        self._names = _LOCAL_NAMES | {web.host.lower(), socket.gethostname().lower()} | beyond

    def is_known_host(self, headers: Headers) -> bool:
        """Is the one Host header a name of ours, or an address in digits?"""
        found = headers.getlist("host")
        if len(found) != 1:
            return False
        try:
            name = urlsplit(f"//{found[0]}").hostname or ""
        except ValueError:
            return False
        return name in self._names or _is_address(name)

    def is_allowed_origin(self, headers: Headers, scheme: str) -> bool:
        """One Origin: this very service as the browser addressed it, or one that the configuration names."""
        found = headers.getlist("origin")
        if len(found) != 1:
            return False
        origin = found[0].lower()
        plain = {"ws": "http", "wss": "https"}.get(scheme, scheme)
        return origin == f"{plain}://{headers['host'].lower()}" or origin in self._origins


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
