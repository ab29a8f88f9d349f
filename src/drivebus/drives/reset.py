"""``reset_fault``: an edge, sent only while two fenced reads show a fault, resent only while they still do. Pure."""

from __future__ import annotations

from drivebus.drives.dialect import Frame
from drivebus.drives.gate import EXPIRY_S, Command, Kind
from drivebus.drives.operation import Talk
from drivebus.drives.start import RESENDS, SETTLE_S, send, send_again
from drivebus.drives.state import DriveState, Outcome, OutcomeWord
from drivebus.drives.talk import Conversation, wait
from drivebus.errors import GateError

FAULTY = frozenset({DriveState.FAULT, DriveState.EMERGENCY_STOPPED})
CLEARED_S = 2.0
"""A drive that still shows its fault after this was not reset, or fell into it again."""


def reset_fault(talk: Talk) -> Conversation[Outcome]:
    """Reset a fault, where there is one. Raises CapabilityError, GateError, Expired or the bus's error."""
    talk.memory.need("reset_fault")
    yield from talk.begin()
    if not (yield from _has_fault(talk)):
        return talk.outcome(OutcomeWord.CONFIRMED, "drives.no_fault", state=talk.verdict.state)
    around = yield from talk.in_time()
    command = talk.command(Kind.RESET, around)
    frames = talk.dialect.reset()
    answer = yield from send(talk, command, frames)
    answered = answer.error is None
    refused = talk.refused(answer)
    if refused is not None:
        return refused
    if not talk.dialect.can_tell:
        return talk.unseen(answered, "drives.reset_acknowledged", "drives.reset_unknown")
    return (yield from _until_cleared(talk, command, frames, answered))


def _has_fault(talk: Talk) -> Conversation[bool]:
    """Two fenced reads show a fault; a drive that reports no state may have one. Raises GateError, the bus's error."""
    can_tell = talk.dialect.can_tell
    # where it can't tell, it must answer at all; and a first reply that equals its request is not believed (F03)
    error = (yield from talk.judged()) if can_tell else (yield from talk.fence())
    if error is not None:
        raise error
    if talk.verdict.state.turning:
        raise GateError("drives.reset_while_turning", state=talk.verdict.state)
    return not can_tell or talk.verdict.state in FAULTY or talk.verdict.fault_code is not None


def _until_cleared(talk: Talk, command: Command, frames: tuple[Frame, ...], answered: bool) -> Conversation[Outcome]:
    """Look until the fault is gone, or has stayed too long; an unanswered reset is sent again while it still stands."""
    sent_again = 0
    while True:
        yield from wait(SETTLE_S)
        error = yield from talk.judged()
        now = yield from talk.still_wanted(command)
        if error is None and talk.verdict.state is not DriveState.UNKNOWN and talk.verdict.state not in FAULTY:
            return talk.outcome(OutcomeWord.CONFIRMED, "drives.reset_confirmed", state=talk.verdict.state)
        still = error is None and talk.verdict.state in FAULTY
        if still and not answered and sent_again < RESENDS and now < command.created_at + EXPIRY_S[Kind.RESET]:
            again = yield from send_again(talk, command, frames)
            answered, sent_again = bool(again), RESENDS if again is None else sent_again + 1
        elif now > command.created_at + CLEARED_S:
            if still:
                return talk.outcome(OutcomeWord.FAILED, "drives.fault_remains", state=talk.verdict.state)
            return talk.outcome(OutcomeWord.UNKNOWN, "drives.reset_unknown")
