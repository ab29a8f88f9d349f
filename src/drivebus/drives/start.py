"""``run``: checked, permitted, sent once, confirmed by fenced reads; never resent blindly (rulings 4 and 6). Pure."""

from __future__ import annotations

from dataclasses import replace

from drivebus.drives.dialect import Frame
from drivebus.drives.gate import EXPIRY_S, Command, Kind
from drivebus.drives.operation import Talk, noted
from drivebus.drives.preflight import ensure
from drivebus.drives.setpoint import set_frequency, shown, write_setpoint
from drivebus.drives.settle import settled
from drivebus.drives.state import Direction, DriveState, Outcome, OutcomeWord
from drivebus.drives.talk import Conversation, wait
from drivebus.errors import CapabilityError, Expired, GateError, Superseded
from drivebus.message import Answer

SETTLE_S = 0.15
"""Between a start and the first look: the reply to a start may still show "stopped" (C320 2.4.6)."""
CONFIRM_S = 3.0
"""A drive that accepted a start and still stands after this did not obey it."""
WITHHELD = (GateError, Expired, Superseded)
"""Why a frame is not sent: no such error may hide that another one has left before."""
RESENDS = 2
"""6.5, class A and B alike: at most twice, while the command lives."""


def run(
    talk: Talk, frequency_hz: float, direction: Direction | None, *, will_wait: bool = False
) -> Conversation[Outcome]:
    """Run at a frequency. Raises before sending: CapabilityError, LimitError, PreflightError, GateError, Expired.

    ``will_wait``: ``reach`` is to follow, so a model that can't show the frequency is refused now.
    """
    memory, dialect = talk.memory, talk.dialect
    memory.need("run")
    memory.check_direction(direction)
    word, actual_hz = talk.check_frequency(frequency_hz)
    dialect.start(direction, word)  # refused here, before anything is sent, where the model or a proof forbids it
    if will_wait and not dialect.can_wait():
        raise CapabilityError("drives.cannot_wait", model=dialect.profile.model)
    yield from talk.begin()
    yield from prepare(talk)
    if talk.verdict.state.turning:
        outcome = yield from _already_turning(talk, frequency_hz, direction)
    else:
        outcome = yield from _from_standstill(talk, actual_hz, direction, word)
    return _with_unread(talk, outcome)


def prepare(talk: Talk) -> Conversation[None]:
    """Status, pre-flight, and the status again where the pre-flight took time. A drive in fault is told first: its
    parameters can't be read then (C320). Raises GateError, PreflightError, or the bus's error."""
    yield from _status_now(talk)
    state = talk.verdict.state
    if talk.dialect.can_tell and not state.turning and state is not DriveState.STOPPED:
        raise GateError("drives.state_forbids", state=state, kind=Kind.START)
    known = talk.memory.preflight
    if (yield from ensure(talk)) is not known:
        yield from _status_now(talk)


def _status_now(talk: Talk) -> Conversation[None]:
    """Two agreeing reads, or the bus's error: a drive that does not answer is not started."""
    error = yield from talk.judged()
    if error is not None:
        raise error


def _already_turning(talk: Talk, frequency_hz: float, direction: Direction | None) -> Conversation[Outcome]:
    """A run that goes on: only its frequency changes. Turning the other way round begins at standstill."""
    verdict = talk.verdict
    wanted = direction or Direction.FORWARD
    runs = verdict.state in (DriveState.RUNNING, DriveState.ACCELERATING, DriveState.DECELERATING)
    if not runs or (verdict.direction is not None and verdict.direction is not wanted):
        shown_direction = verdict.direction if verdict.direction else "?"
        raise GateError("drives.turning", state=verdict.state, direction=shown_direction)
    if verdict.direction is None and direction is not None:
        raise GateError("drives.turning_unknown_way", direction=direction)
    return (yield from set_frequency(talk, frequency_hz))


def _from_standstill(talk: Talk, frequency_hz: float, direction: Direction | None, word: int) -> Conversation[Outcome]:
    if talk.dialect.carries_frequency:
        return (yield from _started(talk, frequency_hz, direction, word))
    around = yield from talk.in_time()
    start = talk.command(Kind.START, around)
    yield from talk.permit(start, talk.dialect.start(direction, word)[0])  # else no frequency is written
    setpoint = talk.command(Kind.SETPOINT, around)
    outcome = yield from write_setpoint(talk, setpoint, word, frequency_hz)
    if not outcome.done:
        return outcome if outcome.word is OutcomeWord.REFUSED else _not_started(outcome)
    yield from talk.still_wanted(setpoint)
    try:
        if talk.dialect.can_tell:
            yield from _status_now(talk)
        return (yield from _started(talk, frequency_hz, direction, word))
    except (GateError, Expired) as withheld:  # they promise that nothing was sent, and the frequency has left
        return talk.outcome(OutcomeWord.FAILED, "drives.not_started", why=withheld)


def _started(talk: Talk, frequency_hz: float, direction: Direction | None, word: int) -> Conversation[Outcome]:
    around = yield from talk.in_time()
    command = talk.command(Kind.START, around)
    frames = talk.dialect.start(direction, word)
    answer = yield from send(talk, command, frames)
    refused = talk.refused(answer)
    if refused is not None:
        return refused
    outcome = yield from confirm(talk, command, frames, direction, answer.error is None)
    if outcome.word is OutcomeWord.CONFIRMED and talk.dialect.carries_frequency:
        return (yield from _with_setpoint(talk, outcome, word, frequency_hz))
    return outcome


def _not_started(outcome: Outcome) -> Outcome:
    """The frequency is not known to have been taken, so the start never left."""
    return replace(outcome, word=OutcomeWord.FAILED, key="drives.not_started", params={"why": outcome})


def send(talk: Talk, command: Command, frames: tuple[Frame, ...]) -> Conversation[Answer]:
    """The acting frame, then what must follow it. Returns the answer to the acting one.

    Raises GateError, Expired, Superseded only before the acting frame has left; whoever looks next sees the rest.
    """
    first: Answer = yield from talk.act(command, frames[0])
    if first.sent:
        try:
            for frame in frames[1:]:
                yield from talk.act(command, frame)
        except WITHHELD:
            pass
    return first


def send_again(talk: Talk, command: Command, frames: tuple[Frame, ...]) -> Conversation[bool | None]:
    """Was it answered? None where it may not be sent any more: what became of the first one is still to be seen."""
    try:
        answer = yield from send(talk, command, frames)
    except WITHHELD:
        return None
    return answer.error is None


def confirm(
    talk: Talk, command: Command, frames: tuple[Frame, ...], direction: Direction | None, answered: bool
) -> Conversation[Outcome]:
    """Was it executed? An unanswered start is sent again only after two fenced reads show standstill (ruling 6)."""
    if not talk.dialect.can_tell:
        return talk.unseen(answered, "drives.start_acknowledged", "drives.start_unknown")
    sent_again = 0
    deadline = (yield from talk.still_wanted(command)) + CONFIRM_S
    talk.seen_turning = False
    while True:
        yield from wait(SETTLE_S)
        error = yield from talk.judged()
        now = yield from talk.still_wanted(command)
        state = talk.verdict.state
        if state.driven:
            return _turning(talk, direction)
        if state in (DriveState.FAULT, DriveState.EMERGENCY_STOPPED, DriveState.NOT_READY) and not talk.seen_turning:
            return talk.outcome(OutcomeWord.FAILED, "drives.start_failed", state=state)
        taken = talk.seen_turning or talk.dialect.start_seen(talk.book)
        may_resend = state is DriveState.STOPPED and not answered and not taken
        if may_resend and sent_again < RESENDS and now < command.created_at + EXPIRY_S[Kind.START]:
            again = yield from send_again(talk, command, frames)
            answered, sent_again = bool(again), RESENDS if again is None else sent_again + 1
        elif talk.seen_turning and state.output_off:
            return talk.outcome(OutcomeWord.FAILED, "drives.started_and_stopped", state=state)
        elif now > deadline:
            return _not_seen(talk, state, error is not None)


def _turning(talk: Talk, direction: Direction | None) -> Outcome:
    found = talk.verdict.direction
    if direction is not None and found is not None and found is not direction:
        return talk.outcome(OutcomeWord.FAILED, "drives.wrong_way", expected=direction, found=found)
    return talk.outcome(OutcomeWord.CONFIRMED, "drives.start_confirmed", state=talk.verdict.state)


def _not_seen(talk: Talk, state: DriveState, silent: bool) -> Outcome:
    if silent or state is DriveState.UNKNOWN or state.turning:  # jogged, braked or ramped down by somebody else
        return talk.outcome(OutcomeWord.UNKNOWN, "drives.start_unknown")
    talk.memory.preflight = None  # whoever starts it again reads first whether it still listens to the bus
    return talk.outcome(OutcomeWord.FAILED, "drives.start_ignored", state=state, after_s=CONFIRM_S)


def _with_setpoint(talk: Talk, outcome: Outcome, word: int, frequency_hz: float) -> Conversation[Outcome]:
    """The start is confirmed; is its frequency?"""
    if not talk.dialect.setpoint_reads():
        return noted(outcome, "drives.setpoint_not_shown", frequency_hz=frequency_hz)
    found = yield from shown(talk, word, frequency_hz, answered=True)
    if found.word is OutcomeWord.FAILED:
        return settled(found)  # raises: it runs, but not at what was asked for (a wrong scale or a wrong drive)
    merged = replace(outcome, evidence=found.evidence)
    if found.word is OutcomeWord.CONFIRMED:
        return merged
    return noted(merged, "drives.setpoint_not_shown", frequency_hz=frequency_hz)


def _with_unread(talk: Talk, outcome: Outcome) -> Outcome:
    """Preconditions that the host could not read are named, never assumed to hold."""
    preflight = talk.memory.preflight
    for notation, why in preflight.unreadable if preflight else ():
        outcome = noted(outcome, "drives.precondition_unread", notation=notation, why=why)
    return outcome
