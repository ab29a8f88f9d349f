"""Difference of two plant configurations. A reload does only what it names; everything else keeps running. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from typing import Any, Generic, Protocol, TypeVar

from drivebus.service.config.model import (
    AlarmConfig,
    BusConfig,
    DriveConfig,
    GatewayConfig,
    GroupConfig,
    InterlockConfig,
    PlantConfig,
)


class ReloadAction(StrEnum):
    """Action of a reload for a drive that exists before and after it."""

    UNCHANGED = "unchanged"
    """No change; the drive misses no poll."""
    UPDATE = "update"
    """New title, limits or policies are taken over; the drive misses no poll."""
    REPOLL = "repoll"
    """Its polls are replaced; it stays on its bus with its permits and stops."""
    RECREATE = "recreate"
    """Another drive or another bus: removed from the bus and added again."""


UPDATE_FIELDS = frozenset({"title", "limits", "on_client_lost", "on_service_stop", "on_restart"})
REPOLL_FIELDS = frozenset({"signals", "min_poll_interval_s"})
UPDATE_BUS_FIELDS = frozenset({"title"})
"""A change of any other field of a bus closes its port and opens another one."""
CONFIG_PARTS = ("buses", "drives", "groups", "interlocks", "alarms", "gateways")
"""Fields of a plant that hold items with an id."""


class _HasId(Protocol):
    @property
    def id(self) -> str: ...


T = TypeVar("T", bound=_HasId)


@dataclass(frozen=True, slots=True)
class PartDiff(Generic[T]):
    """Difference of one kind of items. ``order`` lists all ids of the new configuration."""

    added: Mapping[str, T]
    removed: tuple[str, ...]
    changed: Mapping[str, T]
    order: tuple[str, ...]

    def __bool__(self) -> bool:
        """Whether anything is added, removed or changed; another order alone does not count."""
        return bool(self.added or self.removed or self.changed)

    def applied(self, old: Sequence[T]) -> tuple[T, ...]:
        known = {item.id: item for item in old} | dict(self.added) | dict(self.changed)
        return tuple(known[id] for id in self.order)


@dataclass(frozen=True, slots=True, kw_only=True)
class ConfigDiff:
    """Difference of two plants."""

    buses: PartDiff[BusConfig]
    drives: PartDiff[DriveConfig]
    groups: PartDiff[GroupConfig]
    interlocks: PartDiff[InterlockConfig]
    alarms: PartDiff[AlarmConfig]
    gateways: PartDiff[GatewayConfig]
    actions: Mapping[str, ReloadAction]
    """Action for every drive that is in both."""
    reopened: tuple[str, ...]
    """Buses in both whose port is closed and opened again; the action of their drives is RECREATE."""
    others: Mapping[str, Any]
    """Changed fields of the plant itself (``title``, ``history`` …) with their new values, in a fixed order.

    The page compares two checks of one file, each made in a process of its own, where a set has its own order.
    """

    def __bool__(self) -> bool:
        """Whether anything changes."""
        return bool(any(getattr(self, name) for name in CONFIG_PARTS) or self.others)


def config_diff(old: PlantConfig, new: PlantConfig) -> ConfigDiff:
    """Return the difference from ``old`` to ``new``."""
    parts: dict[str, Any] = {name: _part_diff(getattr(old, name), getattr(new, name)) for name in CONFIG_PARTS}
    before = {bus.id: bus for bus in old.buses}
    reopened = tuple(
        bus.id for bus in new.buses if bus.id in before and _changed_fields(before[bus.id], bus) - UPDATE_BUS_FIELDS
    )
    drives = {drive.id: drive for drive in old.drives}
    actions = {
        drive.id: _reload_action(drives[drive.id], drive, reopened) for drive in new.drives if drive.id in drives
    }
    changed = _changed_fields(old, new) - set(CONFIG_PARTS)
    others = {field.name: getattr(new, field.name) for field in fields(new) if field.name in changed}
    return ConfigDiff(**parts, actions=actions, reopened=reopened, others=others)


def apply_diff(change: ConfigDiff, old: PlantConfig) -> PlantConfig:
    """Apply a difference: ``apply_diff(config_diff(a, b), a) == b``."""
    parts: dict[str, Any] = {name: getattr(change, name).applied(getattr(old, name)) for name in CONFIG_PARTS}
    return replace(old, **parts, **change.others)


def _part_diff(old: Sequence[T], new: Sequence[T]) -> PartDiff[T]:
    before, after = {item.id: item for item in old}, {item.id: item for item in new}
    return PartDiff(
        added={id: item for id, item in after.items() if id not in before},
        removed=tuple(id for id in before if id not in after),
        changed={id: item for id, item in after.items() if id in before and before[id] != item},
        order=tuple(after),
    )


def _reload_action(old: DriveConfig, new: DriveConfig, reopened: Sequence[str]) -> ReloadAction:
    changed = _changed_fields(old, new)
    if new.bus in reopened or changed - UPDATE_FIELDS - REPOLL_FIELDS:
        return ReloadAction.RECREATE
    if changed & REPOLL_FIELDS:
        return ReloadAction.REPOLL
    return ReloadAction.UPDATE if changed else ReloadAction.UNCHANGED


def _changed_fields(old: Any, new: Any) -> set[str]:
    """Return the names of the fields that differ."""
    return {field.name for field in fields(old) if getattr(old, field.name) != getattr(new, field.name)}
