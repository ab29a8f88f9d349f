"""Installed gateways: the object that declares one, and the schema of ``plant.toml`` with their tables.

A gateway connects other programs to the service, as a process of its own: the web, a field protocol, a broker. Its
package names a ``Gateway`` in the entry-point group ``drivebus.gateways``, in a module that imports no library of the
gateway, because the service imports it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pydantic import create_model

from drivebus import i18n
from drivebus.errors import ConfigurationError, SystemReason
from drivebus.profiles.diagnostics import Issue
from drivebus.service.config.model import CertificateFiles
from drivebus.service.config.schema import GatewayTable, GatewayTables, PlantFile

ENTRY_POINT_GROUP = "drivebus.gateways"
GATEWAY_NAME = re.compile(r"[a-z][a-z0-9_]{0,31}")
"""A name is a key of ``plant.toml``, a label of a metric and a field of the schema."""

ResolvePath = Callable[[str], Path]
"""Makes a path of ``plant.toml`` absolute; links are not followed, so that their owners can be checked."""


@dataclass(frozen=True, kw_only=True)
class Gateway:
    """Declaration of one gateway."""

    name: str
    """Name of its entry point and of its table, ``[gateway.<name>]``."""
    module: str
    """Module that its process runs (``python -m``); it calls ``drivebus.gateways.process.run_gateway``."""
    table: type[GatewayTable]
    """Schema of its table. Secrets are files that the table names."""
    settings: Callable[[Any, ResolvePath], Any]
    """Make the settings of its process from a checked table: a frozen dataclass with absolute paths."""
    check: Callable[[Any, ResolvePath], Iterator[Issue]] = lambda table, resolve_path: iter(())
    """Yield the issues of a well-formed table that the schema does not find; paths start in the table."""
    certificates: Callable[[Any], Sequence[CertificateFiles]] = lambda settings: ()
    """Return the TLS certificates that its process serves with these settings; the service announces their end."""
    address: Callable[[Any], str | None] = lambda settings: None
    """Return the address where users open it with these settings; None where it has none, or gets it at its start."""
    listens_at: Callable[[Any], tuple[str, int] | None] = lambda settings: None
    """Return host and TCP port that its process listens at with these settings; the service reports a used port."""
    runs_without_table: bool = False
    """It runs in a plant whose file has no table for it. Then every key of the table has a default."""
    extra: str | None = None
    """Extra of the package drivebus whose libraries its process imports."""
    catalogues: Path | None = None
    """Folder of its texts, ``<name>.<language>.json``, if they are not part of drivebus."""


def installed_gateways() -> Mapping[str, Gateway]:
    """Return every installed gateway by name, sorted. Raises ConfigurationError for one that can't be used."""
    return MappingProxyType(_load_all()[0])


def plant_file_schema() -> type[PlantFile]:
    """Return the schema of ``plant.toml`` with the tables of the installed gateways. Raises ConfigurationError."""
    return _load_all()[1]


def gateway_issues(tables: GatewayTables, resolve_path: ResolvePath) -> Iterator[Issue]:
    """Yield the issues that the gateways find in their tables."""
    for name, table in tables.configured():
        for fault in installed_gateways()[name].check(table, resolve_path):
            yield replace(
                fault,
                path=("gateway", name, *fault.path),
                related=tuple(("gateway", name, *path) for path in fault.related),
            )


def clear_registry() -> None:
    """Discard the loaded gateways; the next use looks up the entry points again."""
    _load_all.cache_clear()


@cache
def _load_all() -> tuple[dict[str, Gateway], type[PlantFile]]:
    points: dict[str, EntryPoint] = {}
    for point in entry_points(group=ENTRY_POINT_GROUP):
        other = points.setdefault(point.name, point)
        if point.value != other.value:
            raise _error(point, ConfigurationError("gateways.same_name", other=other.value))
    gateways = {name: _load(points[name]) for name in sorted(points)}
    fields: dict[str, Any] = {
        name: (gateway.table, gateway.table()) if gateway.runs_without_table else (gateway.table | None, None)
        for name, gateway in gateways.items()
    }
    tables = create_model("GatewayTables", __base__=GatewayTables, **fields)
    return gateways, create_model("PlantFile", __base__=PlantFile, gateway=(tables, tables()))


def _load(point: EntryPoint) -> Gateway:
    try:
        gateway = point.load()
    except Exception as error:
        raise _error(point, SystemReason(error)) from error
    if not isinstance(gateway, Gateway) or gateway.name != point.name or not GATEWAY_NAME.fullmatch(point.name):
        raise _error(point, ConfigurationError("gateways.no_gateway", name=point.name))
    if gateway.catalogues is not None:
        i18n.add_folder(gateway.catalogues)
    return gateway


def _error(point: EntryPoint, reason: SystemReason | ConfigurationError) -> ConfigurationError:
    package = point.dist.name if point.dist is not None else "-"
    return ConfigurationError("gateways.broken", found=point.name, module=point.value, package=package, reason=reason)
