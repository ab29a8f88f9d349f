"""What a changed ``plant.toml`` asks for: only this is done by a reload, everything else goes on. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from typing import Any, Generic, Protocol, TypeVar

from drivebus.plant.model import (
    AlarmSetting,
    BusSetting,
    DriveSetting,
    GroupSetting,
    InterlockSetting,
    PlantSetting,
)


class Fate(StrEnum):
    """What a reload does to a drive that was there before and still is."""

    UNTOUCHED = "untouched"
    """Nothing: it misses no poll."""
    LIVE = "live"
    """Title, limits, policies: taken over as they are; it misses no poll either."""
    POLLS = "polls"
    """Its polls are replaced; it stays on its bus with its fences, permits and stops."""
    ANEW = "anew"
    """It is another drive, or on another line: taken off its bus and added again."""


LIVE_FIELDS = frozenset({"title", "limits", "on_client_lost", "on_service_stop", "on_restart"})
POLL_FIELDS = frozenset({"signals", "fastest_s"})
LIVE_BUS_FIELDS = frozenset({"title"})
"""All other settings of a bus mean that its port is closed and another one opened."""
_PARTS = ("buses", "drives", "groups", "interlocks", "alarms")


class _Named(Protocol):
    @property
    def id(self) -> str: ...


T = TypeVar("T", bound=_Named)


@dataclass(frozen=True, slots=True)
class Part(Generic[T]):
    """One kind of thing: what came, what went, what is different; ``order`` is all of them as they are now."""

    added: Mapping[str, T]
    removed: tuple[str, ...]
    changed: Mapping[str, T]
    order: tuple[str, ...]

    def __bool__(self) -> bool:
        """Is there anything to do? Another order alone is not."""
        return bool(self.added or self.removed or self.changed)

    def applied(self, old: Sequence[T]) -> tuple[T, ...]:
        known = {one.id: one for one in old} | dict(self.added) | dict(self.changed)
        return tuple(known[id] for id in self.order)


@dataclass(frozen=True, slots=True)
class Difference:
    """From one plant to another."""

    buses: Part[BusSetting]
    drives: Part[DriveSetting]
    groups: Part[GroupSetting]
    interlocks: Part[InterlockSetting]
    alarms: Part[AlarmSetting]
    fates: Mapping[str, Fate]
    """Every drive that is in both."""
    reopened: tuple[str, ...]
    """Buses in both whose port must be closed and opened anew; their drives' fate is ``anew``."""
    others: Mapping[str, Any]
    """Further settings of the plant that changed (``title``, ``history``, ``web`` …), with their new values."""

    def __bool__(self) -> bool:
        """Does anything change?"""
        return bool(any(getattr(self, name) for name in _PARTS) or self.others)

    @property
    def untouched(self) -> tuple[str, ...]:
        """Drives that miss no poll and change nothing, in the order of the new file."""
        return tuple(id for id in self.drives.order if self.fates.get(id) is Fate.UNTOUCHED)


def difference(old: PlantSetting, new: PlantSetting) -> Difference:
    """What must be done to get from ``old`` to ``new``."""
    parts: dict[str, Any] = {name: _part(getattr(old, name), getattr(new, name)) for name in _PARTS}
    before = {bus.id: bus for bus in old.buses}
    reopened = tuple(bus.id for bus in new.buses if bus.id in before and _differ(before[bus.id], bus) - LIVE_BUS_FIELDS)
    drives = {drive.id: drive for drive in old.drives}
    fates = {drive.id: _fate(drives[drive.id], drive, reopened) for drive in new.drives if drive.id in drives}
    others = {name: getattr(new, name) for name in _differ(old, new) - set(_PARTS)}
    return Difference(**parts, fates=fates, reopened=reopened, others=others)


def apply(change: Difference, old: PlantSetting) -> PlantSetting:
    """``apply(difference(a, b), a) == b``."""
    parts: dict[str, Any] = {name: getattr(change, name).applied(getattr(old, name)) for name in _PARTS}
    return replace(old, **parts, **change.others)


def _part(old: Sequence[T], new: Sequence[T]) -> Part[T]:
    before, after = {one.id: one for one in old}, {one.id: one for one in new}
    return Part(
        added={id: one for id, one in after.items() if id not in before},
        removed=tuple(id for id in before if id not in after),
        changed={id: one for id, one in after.items() if id in before and before[id] != one},
        order=tuple(after),
    )


def _fate(old: DriveSetting, new: DriveSetting, reopened: Sequence[str]) -> Fate:
    found = _differ(old, new)
    if new.bus in reopened or found - LIVE_FIELDS - POLL_FIELDS:
        return Fate.ANEW
    if found & POLL_FIELDS:
        return Fate.POLLS
    return Fate.LIVE if found else Fate.UNTOUCHED


def _differ(old: Any, new: Any) -> set[str]:
    """Names of the fields that are different."""
    return {one.name for one in fields(old) if getattr(old, one.name) != getattr(new, one.name)}
