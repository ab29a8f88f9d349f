"""Declaration of the web as a gateway, and its table of ``plant.toml``.

The service imports this module, so it imports no HTTP.
"""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import Field

from drivebus.profiles.diagnostics import Issue, issue
from drivebus.service.config.gateways import Gateway, ResolvePath
from drivebus.service.config.loopback import is_loopback
from drivebus.service.config.model import CertificateFiles
from drivebus.service.config.schema import GatewayTable, PathText, Title
from drivebus.values import Text


@dataclass(frozen=True, slots=True, kw_only=True)
class WebConfig:
    """Address of the page and the API. Any but loopback needs ``certificate`` and an administrator."""

    host: str = "127.0.0.1"
    port: int = 8080
    certificate: Path | None = None
    key: Path | None = None
    origins: tuple[str, ...] = ()
    """Further origins under which browsers reach the page, such as a reverse proxy's."""
    trusted_proxies: tuple[str, ...] = ()
    """Addresses or networks of reverse proxies whose ``X-Forwarded-For`` names the client."""
    login_notice: Text | None = None
    """Text of the login page and of the form that unlocks an idle session; every client on the network can read it."""


_DEFAULTS = WebConfig()
WILDCARD_HOSTS = ("0.0.0.0", "::")
_ORIGIN = re.compile(r"https?://[A-Za-z0-9._\-\[\]:]+")


class WebTable(GatewayTable):
    """Schema of ``[gateway.web]``."""

    host: Annotated[str, Field(min_length=1, max_length=255)] = _DEFAULTS.host
    port: Annotated[int, Field(ge=0, le=65_535)] = _DEFAULTS.port
    certificate: PathText | None = None
    key: PathText | None = None
    origins: list[str] = []
    trusted_proxies: list[str] = []
    login_notice: Title | None = None


def web_config(table: WebTable, resolve_path: ResolvePath) -> WebConfig:
    """Return the settings of the web process."""
    return WebConfig(
        host=table.host,
        port=table.port,
        certificate=resolve_path(table.certificate) if table.certificate else None,
        key=resolve_path(table.key) if table.key else None,
        origins=tuple(table.origins),
        trusted_proxies=tuple(table.trusted_proxies),
        login_notice=Text.from_mapping(table.login_notice) if table.login_notice else None,
    )


def web_issues(table: WebTable, resolve_path: ResolvePath) -> Iterator[Issue]:
    """Yield issues that the schema does not find: missing files, open address without TLS, bad origins and proxies."""
    for name, other in (("certificate", "key"), ("key", "certificate")):
        text = getattr(table, name)
        if text is None:
            continue
        if not resolve_path(text).is_file():
            yield issue("web_file", (name,), str(resolve_path(text)))
        if getattr(table, other) is None:
            yield issue("needs_other", (name,), text, other=other)
    if table.enabled and table.certificate is None and not is_loopback(table.host):
        yield issue("tls", ("host",), table.host)
    for origin in table.origins:
        if not _ORIGIN.fullmatch(origin):
            yield issue("origin", ("origins",), origin)
    for proxy in table.trusted_proxies:
        if not _is_network(proxy):
            yield issue("trusted_proxy", ("trusted_proxies",), proxy)


def _is_network(text: str) -> bool:
    """Return whether a text is an address or network, and not that of every address."""
    try:
        return ipaddress.ip_network(text).prefixlen > 0
    except ValueError:
        return False


def web_certificates(web: WebConfig) -> tuple[CertificateFiles, ...]:
    """Return the certificate of the page, if it has one."""
    return () if web.certificate is None or web.key is None else (CertificateFiles(web.certificate, web.key),)


def url_host(host: str) -> str:
    """Return a host as a URL has it: an IPv6 address in brackets."""
    return f"[{host}]" if ":" in host else host


def web_address(web: WebConfig) -> str | None:
    """Return the URL of the page; None for port 0, which the system chooses.

    ``HOST`` stands for the names of this machine where the page listens on all its addresses.
    """
    if web.port == 0:
        return None
    scheme = "http" if web.certificate is None else "https"
    host = "HOST" if web.host in WILDCARD_HOSTS else url_host(web.host)
    return f"{scheme}://{host}:{web.port}"


GATEWAY = Gateway(
    name="web",
    module="drivebus.web",
    table=WebTable,
    settings=web_config,
    check=web_issues,
    certificates=web_certificates,
    address=web_address,
    listens_at=lambda web: (web.host, web.port),
    runs_without_table=True,
    extra="server",
)
