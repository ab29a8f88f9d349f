"""``reset_fault``: an edge, sent only while two fenced reads show a fault, resent only while they still do. Pure."""

from __future__ import annotations

from drivebus.drives.gate import EXPIRY_S, Kind
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
    if talk.dialect.can_tell:
        error = yield from talk.judged()
        if error is not None:
            raise error
        if talk.verdict.state.turning:
            raise GateError("drives.reset_while_turning", state=talk.verdict.state)
        if talk.verdict.state not in FAULTY and talk.verdict.fault_code is None:
            return talk.outcome(OutcomeWord.CONFIRMED, "drives.no_fault", state=talk.verdict.state)
    else:  # it must answer at all; and a first reply that equals its request would not be believed (F03)
        error = yield from talk.fence()
        if error is not None:
            raise error
    around = yield from talk.in_time()
    command = talk.command(Kind.RESET, around)
    frames = talk.dialect.reset()
    answer = yield from send(talk, command, frames)
    if not answer.sent and answer.error is not None:
        raise answer.error
    refused = None if answer.reply is None else talk.dialect.refusal(answer.reply)
    if refused is not None:
        return talk.outcome(OutcomeWord.REFUSED, refused.key, code=refused.code)
    answered = answer.error is None
    if not talk.dialect.can_tell:
        word = OutcomeWord.ACKNOWLEDGED if answered else OutcomeWord.UNKNOWN
        return talk.outcome(word, "drives.reset_acknowledged" if answered else "drives.reset_unknown")
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
