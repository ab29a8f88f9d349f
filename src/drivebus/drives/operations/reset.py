"""``reset_fault``: an edge, sent only while two fenced reads show a fault, resent only while they still do. Pure."""

from __future__ import annotations

from drivebus.drives.dialects.base import CommandFrame
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.start import COMMAND_SETTLE_S, MAX_RESENDS, resend_frames, send_frames
from drivebus.drives.operations.steps import DriveOperation, wait
from drivebus.drives.permissives import COMMAND_TTL_S, CommandKind, DriveCommand
from drivebus.drives.state import DriveState, Outcome, OutcomeStatus
from drivebus.errors import StartInhibited

FAULT_STATES = frozenset({DriveState.FAULT, DriveState.EMERGENCY_STOPPED})
RESET_CONFIRM_TIMEOUT_S = 2.0
"""A drive that still shows its fault after this was not reset, or fell into it again."""


def reset_fault(talk: OperationContext) -> DriveOperation[Outcome]:
    """Reset a fault, where there is one. Raises CapabilityError, StartInhibited, Expired or the bus's error."""
    talk.drive.require_capability("reset_fault")
    yield from talk.start_clock()
    if not (yield from _has_fault(talk)):
        return talk.outcome(OutcomeStatus.CONFIRMED, "drives.no_fault", state=talk.derived.state)
    around = yield from talk.check_deadline()
    command = talk.create_command(CommandKind.RESET, around)
    frames = talk.dialect.reset()
    answer = yield from send_frames(talk, command, frames)
    answered = answer.error is None
    refused = talk.rejected_outcome(answer)
    if refused is not None:
        return refused
    if not talk.dialect.reports_run_state:
        return talk.unverifiable_outcome(answered, "drives.reset_acknowledged", "drives.reset_unknown")
    return (yield from _wait_until_cleared(talk, command, frames, answered))


def _has_fault(talk: OperationContext) -> DriveOperation[bool]:
    """Read the fault twice, each behind a sync probe; a drive that reports no state may have one."""
    can_tell = talk.dialect.reports_run_state
    # where it can't tell, it must answer at all; and a first reply that equals its request is not believed (F03)
    error = (yield from talk.read_verified_state()) if can_tell else (yield from talk.sync())
    if error is not None:
        raise error
    if talk.derived.state.turning:
        raise StartInhibited("drives.reset_while_turning", state=talk.derived.state)
    return not can_tell or talk.derived.state in FAULT_STATES or talk.derived.fault_code is not None


def _wait_until_cleared(
    talk: OperationContext, command: DriveCommand, frames: tuple[CommandFrame, ...], answered: bool
) -> DriveOperation[Outcome]:
    """Look until the fault is gone, or has stayed too long; an unanswered reset is sent again while it still stands."""
    sent_again = 0
    while True:
        yield from wait(COMMAND_SETTLE_S)
        error = yield from talk.read_verified_state()
        now = yield from talk.check_not_superseded(command)
        if error is None and talk.derived.state is not DriveState.UNKNOWN and talk.derived.state not in FAULT_STATES:
            return talk.outcome(OutcomeStatus.CONFIRMED, "drives.reset_confirmed", state=talk.derived.state)
        still = error is None and talk.derived.state in FAULT_STATES
        if (
            still
            and not answered
            and sent_again < MAX_RESENDS
            and now < command.created_at + COMMAND_TTL_S[CommandKind.RESET]
        ):
            again = yield from resend_frames(talk, command, frames)
            answered, sent_again = bool(again), MAX_RESENDS if again is None else sent_again + 1
        elif now > command.created_at + RESET_CONFIRM_TIMEOUT_S:
            if still:
                return talk.outcome(OutcomeStatus.FAILED, "drives.fault_remains", state=talk.derived.state)
            return talk.outcome(OutcomeStatus.UNKNOWN, "drives.reset_unknown")
