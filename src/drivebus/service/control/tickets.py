"""A command as somebody wished it: when, and how often its drives had been stopped by then."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from drivebus.drives.operations.context import CHECKS_TIMEOUT_S
from drivebus.errors import Superseded
from drivebus.service.auth.actor import Actor
from drivebus.service.runtime.drive import DriveRuntime
from drivebus.service.runtime.plant import Plant
from drivebus.types import Json

START_DEADLINE_S = CHECKS_TIMEOUT_S
"""From the wish (the second step of a start, as it comes in) to the first bit of a frame that moves: record, turn and
checks share it, and none of it comes on top. Gate and bus hold it, and 2 s from the checks on (ruling 12, I1)."""


@dataclass(frozen=True, slots=True)
class CommandTicket:
    """``at``: a monotonic second of the plant. ``stops``: of each drive that it concerns; ``units``: those drives."""

    issued_at: float
    stop_counts: Mapping[str, int]
    drives: tuple[DriveRuntime, ...]


OperationHandler = Callable[[Any, Actor], Awaitable[Json]]
"""Handler of an operation: validated parameters and actor → answer."""
MotionHandler = Callable[[Any, Actor, CommandTicket], Awaitable[Json]]
"""A ``Handler`` of what moves: it must know when that was wished."""


def issue_ticket(plant: Plant, runtimes: Iterable[DriveRuntime]) -> CommandTicket:
    """Somebody wishes something of these, now."""
    known = tuple(runtimes)
    return CommandTicket(plant.now(), {runtime.id: plant.stop_counts[runtime.id] for runtime in known}, known)


def check_not_superseded(plant: Plant, ticket: CommandTicket) -> None:
    """Raises Superseded where one of its drives was stopped since, or is another one by now; one that is gone is for
    its handler to tell."""
    for runtime in ticket.drives:
        if plant.stop_counts[runtime.id] != ticket.stop_counts[runtime.id]:
            raise Superseded("plant.stopped_meanwhile", drive=runtime.id)
        if plant.drives.get(runtime.id, runtime) is not runtime:
            raise Superseded("plant.another_meanwhile", drive=runtime.id)
