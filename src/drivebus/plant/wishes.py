"""A command as somebody wished it: when, and how often its drives had been stopped by then."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from drivebus.drives.operation import PREPARE_S
from drivebus.errors import Superseded
from drivebus.plant.actor import Actor
from drivebus.plant.state import Plant
from drivebus.plant.units import Unit

START_S = PREPARE_S
"""From the wish (the second step of a start, as it comes in) to the first bit of a frame that moves: record, turn and
checks share it, and none of it comes on top. Gate and bus hold it, and 2 s from the checks on (ruling 12, I1)."""


@dataclass(frozen=True, slots=True)
class Wish:
    """``at``: a monotonic second of the plant. ``stops``: of each drive that it concerns; ``units``: those drives."""

    at: float
    stops: Mapping[str, int]
    units: tuple[Unit, ...]


Motion = Callable[[Any, Actor, Wish], Awaitable[dict[str, Any]]]
"""A ``Handler`` of what moves: it must know when that was wished."""


def wished(plant: Plant, units: Iterable[Unit]) -> Wish:
    """Somebody wishes something of these, now."""
    known = tuple(units)
    return Wish(plant.now(), {unit.id: plant.stops[unit.id] for unit in known}, known)


def still(plant: Plant, wish: Wish) -> None:
    """Raises Superseded where one of its drives was stopped since, or is another one by now; one that is gone is for
    its handler to tell."""
    for unit in wish.units:
        if plant.stops[unit.id] != wish.stops[unit.id]:
            raise Superseded("plant.stopped_meanwhile", drive=unit.id)
        if plant.units.get(unit.id, unit) is not unit:
            raise Superseded("plant.another_meanwhile", drive=unit.id)
