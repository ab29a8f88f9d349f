"""Begin and end a jog.

These drives have no dead-man function of their own: a jog goes on until it is stopped, so ``JogSession`` limits it.
"""

from __future__ import annotations

from drivebus.drives.context import DriveContext
from drivebus.drives.dialects.base import CommandFrame, StopMode
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.start import check_readiness, send_frames
from drivebus.drives.operations.steps import DriveOperation
from drivebus.drives.operations.stop import send_stop, stop
from drivebus.drives.outcome import Outcome, OutcomeStatus
from drivebus.drives.permissives import CommandKind
from drivebus.drives.state import Direction
from drivebus.errors import LimitError
from drivebus.values import Text

MAX_JOG_LEASE_S = 0.5  # longest time that the motor turns after the last renewal


def check_jog_lease(lease_s: float) -> float:
    """Return the lease. Raises LimitError unless it is above 0 and at most 0.5 s."""
    if not 0.0 < lease_s <= MAX_JOG_LEASE_S:
        raise LimitError("drives.lease_too_long", lease_s=lease_s, limit_s=MAX_JOG_LEASE_S)
    return lease_s


def begin_jog(op: OperationContext, frequency_hz: float | None, direction: Direction) -> DriveOperation[Outcome]:
    """Begin to jog from standstill. The frame is sent once; an unanswered jog is stopped at once."""
    frames = check_jog(op.drive, frequency_hz, direction)
    op.limits_checked = True
    yield from op.start_clock()
    yield from check_readiness(op)
    return (yield from send_jog(op, frames))


def check_jog(drive: DriveContext, frequency_hz: float | None, direction: Direction) -> tuple[CommandFrame, ...]:
    """Return the frames of a jog after what can be checked without a read of the drive.

    Without a frequency the drive uses its own, set on its keypad. Raises CapabilityError, LimitError or StartInhibited.
    """
    drive.require_capability("jog")
    drive.check_direction(direction)
    word = None if frequency_hz is None else drive.check_frequency(frequency_hz)[0]
    return drive.dialect.jog(direction, word)


def send_jog(op: OperationContext, frames: tuple[CommandFrame, ...]) -> DriveOperation[Outcome]:
    """Send the jog frame once; stop the drive unless it acknowledges the frame or rejects it.

    Raises Expired where the checks before it took too long.
    """
    conditions = yield from op.check_deadline()
    command = op.create_command(CommandKind.JOG, conditions)
    result = yield from send_frames(op, command, frames)
    refused = op.rejected_outcome(result)
    if refused is not None:
        return refused
    if result.error is None:
        return op.outcome(OutcomeStatus.ACKNOWLEDGED, "drives.jog_begun")
    stopped = yield from end_jog(op)
    return op.outcome(OutcomeStatus.UNKNOWN, "drives.jog_unknown", ended=Text.per_language(stopped.text))


def end_jog(op: OperationContext) -> DriveOperation[Outcome]:
    """End the jog by the family's jog stop, then by an ordinary stop until the drive reports standstill."""
    if op.dialect.reports_run_state:
        yield from send_stop(op, StopMode.JOG_STOP)
    return (yield from stop(op, StopMode.STOP))
