"""Jog: the frame that begins it and the end of it. The lease around them is the shell's (``lease``). Pure.

A jog has no dead-man on these drives (T13): whoever begins one has to keep its lease alive, 500 ms at most.
"""

from __future__ import annotations

from drivebus.drives.dialects.base import CommandFrame, StopMode
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.start import check_readiness, send_frames
from drivebus.drives.operations.steps import DriveOperation, get_bus_conditions
from drivebus.drives.operations.stop import send_stop, stop
from drivebus.drives.permissives import CommandKind
from drivebus.drives.state import Direction, Outcome, OutcomeStatus
from drivebus.errors import LimitError

MAX_JOG_LEASE_S = 0.5
"""T13: no motion outlives the hand on the key by more."""


def check_jog_lease(lease_s: float) -> float:
    """Raises LimitError for a lease that is none."""
    if not 0.0 < lease_s <= MAX_JOG_LEASE_S:
        raise LimitError("drives.lease_too_long", lease_s=lease_s, limit_s=MAX_JOG_LEASE_S)
    return lease_s


def begin_jog(talk: OperationContext, frequency_hz: float | None, direction: Direction) -> DriveOperation[Outcome]:
    """Begin to jog from standstill; sent once. An unanswered jog is stopped at once: nobody knows whether it turns."""
    memory, dialect = talk.drive, talk.dialect
    memory.require_capability("jog")
    memory.check_direction(direction)
    word = None if frequency_hz is None else talk.check_frequency(frequency_hz)[0]
    talk.limits_checked = True  # without a frequency it is the drive's own, set on its keypad
    frames = dialect.jog(direction, word)
    yield from talk.start_clock()
    yield from check_readiness(talk)
    yield from talk.check_deadline()
    return (yield from send_jog(talk, frames))


def send_jog(talk: OperationContext, frames: tuple[CommandFrame, ...]) -> DriveOperation[Outcome]:
    """The jog frame, once; whatever does not end in a yes is stopped."""
    around = yield from get_bus_conditions()
    command = talk.create_command(CommandKind.JOG, around)
    answer = yield from send_frames(talk, command, frames)
    refused = talk.rejected_outcome(answer)
    if refused is not None:
        talk.may_be_running = False
        return refused
    if answer.error is None:
        return talk.outcome(OutcomeStatus.ACKNOWLEDGED, "drives.jog_begun")
    yield from end_jog(talk)
    return talk.outcome(OutcomeStatus.UNKNOWN, "drives.jog_unknown")


def end_jog(talk: OperationContext) -> DriveOperation[Outcome]:
    """End the jog: the family's jog stop, then an ordinary stop until the drive reports standstill."""
    if talk.dialect.reports_run_state:
        yield from send_stop(talk, StopMode.JOG_STOP)
    return (yield from stop(talk, StopMode.STOP))
