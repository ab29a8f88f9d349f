"""TLS of the connection to the history's database: the certificate of a server elsewhere is verified by default."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from urllib.parse import parse_qs, unquote, urlsplit

from drivebus.service.config.loopback import is_loopback

VERIFY = "verify-full"
"""Mode of libpq and asyncpg that checks both the authority and the name of the server."""
_PORT = re.compile(r":\d*$")


def default_sslmode(url: str) -> str | None:
    """Return ``verify-full`` for a server elsewhere where neither URL, environment nor a service file names a mode."""
    named = {"sslmode", "service"} & _parameters(url).keys() or {"PGSSLMODE", "PGSERVICE"} & os.environ.keys()
    return VERIFY if not named and remote_hosts(url) else None


def unverified_sslmode(url: str) -> str | None:
    """Return the mode of a URL that leaves the certificate of a server elsewhere, or its name, unverified."""
    mode = _parameters(url).get("sslmode")
    return mode if mode not in (None, VERIFY) and remote_hosts(url) else None


def remote_hosts(url: str) -> list[str]:
    """Return the hosts of a URL that are not this machine; a host may be the folder of a Unix socket."""
    return [host for host in _hosts(url) if host and not host.startswith("/") and not is_loopback(host.strip("[]"))]


def _hosts(url: str) -> Iterator[str]:
    named = urlsplit(url).netloc.rpartition("@")[2] or _parameters(url).get("host") or os.environ.get("PGHOST", "")
    for host in named.split(","):
        yield unquote(_PORT.sub("", host))


def _parameters(url: str) -> dict[str, str]:
    return {name: values[-1] for name, values in parse_qs(urlsplit(url).query).items()}
