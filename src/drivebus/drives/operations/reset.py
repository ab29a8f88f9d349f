"""Reset a fault: an edge-triggered command, sent and resent only while a verified state shows a fault."""

from __future__ import annotations

from drivebus.drives.dialects.base import CommandFrame
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.preparation import release_reset
from drivebus.drives.operations.start import COMMAND_SETTLE_S, MAX_RESENDS, resend_frames, send_frames
from drivebus.drives.operations.steps import DriveOperation, wait
from drivebus.drives.outcome import Outcome, OutcomeStatus
from drivebus.drives.permissives import COMMAND_TTL_S, CommandKind, DriveCommand
from drivebus.drives.state import DriveState
from drivebus.errors import StartInhibited

FAULT_STATES = frozenset({DriveState.FAULT, DriveState.EMERGENCY_STOPPED})
RESET_CONFIRM_TIMEOUT_S = 2.0  # a fault that is still reported after this was not reset, or came back


def reset_fault(op: OperationContext) -> DriveOperation[Outcome]:
    """Reset a fault if there is one. Raises CapabilityError, StartInhibited, Expired or the error of the bus."""
    op.drive.require_capability("reset_fault")
    yield from op.start_clock()
    if not (yield from _has_fault(op)):
        return op.outcome(OutcomeStatus.CONFIRMED, "drives.no_fault", state=op.derived.state)
    yield from release_reset(op)
    conditions = yield from op.check_deadline()
    command = op.create_command(CommandKind.RESET, conditions)
    frames = op.dialect.reset()
    result = yield from send_frames(op, command, frames)
    answered = result.error is None
    refused = op.rejected_outcome(result)
    if refused is not None:
        return refused
    if not op.dialect.reports_run_state:
        return op.unverifiable_outcome("drives.reset_acknowledged", "drives.reset_unknown", answered=answered)
    return (yield from _wait_until_cleared(op, command, frames, answered=answered))


def _has_fault(op: OperationContext) -> DriveOperation[bool]:
    """Read the fault twice, each behind a sync probe; a drive that reports no state may have one."""
    can_tell = op.dialect.reports_run_state
    # without a run status the drive must at least answer a sync probe
    error = (yield from op.read_verified_state()) if can_tell else (yield from op.sync())
    if error is not None:
        raise error
    if op.derived.state.turning and not _is_in_fault(op):
        raise StartInhibited("drives.reset_while_turning", state=op.derived.state)
    if can_tell and op.derived.state is DriveState.UNKNOWN:
        raise StartInhibited("drives.fault_unknown", why=op.derived.unknown_reason)
    return not can_tell or _is_in_fault(op) or op.derived.fault_code is not None


def _is_in_fault(op: OperationContext) -> bool:
    """Return whether the drive reports a fault without motion; its frequency may remain that before the trip."""
    derived = op.derived
    remains = derived.by_frequency and op.reading_pairs.agreed_raw("output_frequency") is not None
    return derived.state in FAULT_STATES or (remains and derived.fault_code is not None)


def _wait_until_cleared(
    op: OperationContext, command: DriveCommand, frames: tuple[CommandFrame, ...], *, answered: bool
) -> DriveOperation[Outcome]:
    """Read the state until the fault is gone or has stayed too long; resend an unanswered reset while it stays."""
    sent_again = 0
    while True:
        yield from wait(COMMAND_SETTLE_S)
        error = yield from op.read_verified_state()
        now = yield from op.check_not_superseded(command)
        if error is None and op.derived.state is not DriveState.UNKNOWN and not _is_in_fault(op):
            return op.outcome(OutcomeStatus.CONFIRMED, "drives.reset_confirmed", state=op.derived.state)
        still = error is None and _is_in_fault(op)
        if (
            still
            and not answered
            and sent_again < MAX_RESENDS
            and now < command.created_at + COMMAND_TTL_S[CommandKind.RESET]
        ):
            answered_again = yield from resend_frames(op, command, frames)
            answered, sent_again = bool(answered_again), MAX_RESENDS if answered_again is None else sent_again + 1
        elif now > command.created_at + RESET_CONFIRM_TIMEOUT_S:
            if still:
                state = DriveState.FAULT if op.derived.by_frequency else op.derived.state
                return op.outcome(OutcomeStatus.FAILED, "drives.fault_remains", state=state)
            return op.outcome(OutcomeStatus.UNKNOWN, "drives.reset_unknown")
