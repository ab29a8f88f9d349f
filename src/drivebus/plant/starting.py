"""What forbids a start now: said in every view before anyone tries, and refused when somebody does."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from drivebus.drives import gate
from drivebus.drives.shell import surroundings
from drivebus.errors import AuditUnavailable, DrivebusError, Interlocked, ServiceUnavailable, WaiverNeeded
from drivebus.plant.failure import both, plain
from drivebus.plant.state import Plant
from drivebus.plant.units import Unit

Json = dict[str, Any]


def reasons(plant: Plant, unit: Unit) -> Iterator[DrivebusError]:
    """Everything that the plant has against a start now; the drive's own gate looks again when it comes to it."""
    if plant.state != "running":
        yield ServiceUnavailable("plant.stopping")
        return
    address = unit.setting.address
    around = surroundings(unit.bus, address)
    yield from gate.against_anything(address, around)
    yield from gate.against_motion(around, unit.profile.family)
    for violation in plant.parts.interlocks.violations(unit.id):
        yield Interlocked("interlocks.violated", **violation.params)
    if unit.badge.kind != "trips" and unit.waiver is None:
        yield _unwaived(unit)
    if not plant.parts.trail.ok:
        yield AuditUnavailable("plant.audit_unavailable")


def _unwaived(unit: Unit) -> WaiverNeeded:
    """Somebody has recorded a waiver, for another drive: told, so that nobody looks for it."""
    other = unit.waiver_of_another
    if other is None:
        return WaiverNeeded("plant.waiver_needed", drive=unit.id, why=unit.badge.text)
    return WaiverNeeded("plant.waiver_of_another", drive=unit.id, why=unit.badge.text, **other.whose)


def hindrances(plant: Plant, unit: Unit) -> Iterator[Json]:
    """The same as JSON."""
    for error in reasons(plant, unit):
        yield {"key": error.key, "params": plain(error.params), "text": both(error.key, error.params)}


def check(plant: Plant, unit: Unit) -> None:
    """Raises the first of them."""
    for error in reasons(plant, unit):
        raise error
