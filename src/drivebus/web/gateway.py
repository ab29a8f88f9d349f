"""Declaration of the web as a gateway, and its table of ``plant.toml``.

The service imports this module, so it imports no HTTP.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import Field

from drivebus.profiles.diagnostics import Issue, issue
from drivebus.service.config.gateways import Gateway, ResolvePath
from drivebus.service.config.loopback import is_loopback
from drivebus.service.config.schema import GatewayTable, PathText


@dataclass(frozen=True, slots=True)
class WebConfig:
    """Address of the page and the API. Any but loopback needs ``certificate`` and an administrator."""

    host: str = "127.0.0.1"
    port: int = 8080
    certificate: Path | None = None
    key: Path | None = None
    origins: tuple[str, ...] = ()
    """Further origins under which browsers reach the page, such as a reverse proxy's."""


_DEFAULTS = WebConfig()
_ORIGIN = re.compile(r"https?://[A-Za-z0-9._\-\[\]:]+")


class WebTable(GatewayTable):
    """Schema of ``[gateway.web]``."""

    host: Annotated[str, Field(min_length=1, max_length=255)] = _DEFAULTS.host
    port: Annotated[int, Field(ge=0, le=65_535)] = _DEFAULTS.port
    certificate: PathText | None = None
    key: PathText | None = None
    origins: list[str] = []


def web_config(table: WebTable, resolve_path: ResolvePath) -> WebConfig:
    """Return the settings of the web process."""
    return WebConfig(
        host=table.host,
        port=table.port,
        certificate=resolve_path(table.certificate) if table.certificate else None,
        key=resolve_path(table.key) if table.key else None,
        origins=tuple(table.origins),
    )


def web_problems(table: WebTable, resolve_path: ResolvePath) -> Iterator[Issue]:
    """Yield what the schema does not find: missing files, an open address without TLS, origins of another form."""
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


GATEWAY = Gateway(
    name="web",
    module="drivebus.web",
    table=WebTable,
    settings=web_config,
    check=web_problems,
    runs_without_table=True,
    extra="server",
)
