"""Command ticket: issue time and each drive's stop count, to reject commands that a stop has overtaken."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from drivebus.errors import Superseded
from drivebus.service.auth.actor import Actor
from drivebus.service.runtime.drive import DriveRuntime
from drivebus.service.runtime.plant import Plant
from drivebus.types import Json


@dataclass(frozen=True, slots=True)
class CommandTicket:
    """Issue time (monotonic) of a command, the drives it affects, and how often each had been stopped by then."""

    issued_at: float
    stop_counts: Mapping[str, int]
    drives: tuple[DriveRuntime, ...]


OperationHandler = Callable[[Any, Actor], Awaitable[Json]]
"""Handler of an operation: validated parameters and actor → answer."""
MotionHandler = Callable[[Any, Actor, CommandTicket], Awaitable[Json]]
"""Handler of an operation that moves motors; by its ticket it sends nothing that a later stop has voided."""


def issue_ticket(plant: Plant, runtimes: Iterable[DriveRuntime]) -> CommandTicket:
    """Return a ticket for a command to these drives."""
    drives = tuple(runtimes)
    return CommandTicket(plant.now(), {runtime.id: plant.stop_counts[runtime.id] for runtime in drives}, drives)


def check_not_superseded(plant: Plant, ticket: CommandTicket) -> None:
    """Raise Superseded where a drive was stopped, or replaced by a reload, since the ticket was issued.

    A drive that is gone is reported by the handler.
    """
    for runtime in ticket.drives:
        if plant.stop_counts[runtime.id] != ticket.stop_counts[runtime.id]:
            raise Superseded("plant.stopped_meanwhile", drive=runtime.id)
        if plant.drives.get(runtime.id, runtime) is not runtime:
            raise Superseded("plant.another_meanwhile", drive=runtime.id)
