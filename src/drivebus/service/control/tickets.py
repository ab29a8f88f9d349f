"""Command ticket: issue time, and how often each drive had been stopped, to reject what a stop has overtaken."""

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
    actor: Actor
    stop_counts: Mapping[str, int]
    control_end_counts: Mapping[str, int]
    """Number of times that control of a drive had ended by then, of each drive that the session controlled."""
    drives: tuple[DriveRuntime, ...]


OperationHandler = Callable[[Any, Actor], Awaitable[Json]]
"""Handler of an operation: validated parameters and actor → answer."""
MotionHandler = Callable[[Any, Actor, CommandTicket], Awaitable[Json]]
"""Handler of an operation that moves motors; by its ticket it sends nothing that a later stop has voided."""


def issue_ticket(plant: Plant, runtimes: Iterable[DriveRuntime], actor: Actor) -> CommandTicket:
    """Return a ticket for a command of ``actor`` to these drives."""
    drives, now = tuple(runtimes), plant.now()
    return CommandTicket(
        issued_at=now,
        actor=actor,
        stop_counts={runtime.id: plant.stop_counts[runtime.id] for runtime in drives},
        control_end_counts={
            runtime.id: plant.control_end_counts[runtime.id]
            for runtime in drives
            if plant.leases.controls(runtime.id, actor, now)
        },
        drives=drives,
    )


def check_not_superseded(plant: Plant, ticket: CommandTicket) -> None:
    """Raise Superseded as ``check_not_stopped``, and where its session gave up control and took it again meanwhile.

    That control has ended is reported by the handler, if it needs control.
    """
    check_not_stopped(plant, ticket)
    for drive, count in ticket.control_end_counts.items():
        has_ended = plant.control_end_counts[drive] != count
        if has_ended and plant.leases.controls(drive, ticket.actor, plant.now()):
            raise Superseded("plant.control_ended_meanwhile", drive=drive)


def check_not_stopped(plant: Plant, ticket: CommandTicket) -> None:
    """Raise Superseded where a drive was stopped, or replaced by a reload, since the ticket was issued.

    A drive that is gone is reported by the handler.
    """
    for runtime in ticket.drives:
        if plant.stop_counts[runtime.id] != ticket.stop_counts[runtime.id]:
            raise Superseded("plant.stopped_meanwhile", drive=runtime.id)
        if plant.drives.get(runtime.id, runtime) is not runtime:
            raise Superseded("plant.another_meanwhile", drive=runtime.id)
