"""``stop``, ``coast``, ``quick_stop``: sent before anything else, resent until the drive reports it (ruling 5). Pure.

No check of the host ever withholds a stop: nothing here asks the gate.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

from drivebus.drives.dialect import Stop
from drivebus.drives.operation import Talk
from drivebus.drives.state import DriveState, Outcome, OutcomeWord
from drivebus.drives.talk import Conversation, look, wait
from drivebus.message import Answer, Lane, WriteClass

PATIENCE_S = 2.0
"""G07: a stop that shows no progress for this long is declared unconfirmed …"""
PATIENCE_TRANSACTIONS = 16
"""… or for as long as two looks and two stops take on this line (300 baud: 10 s)."""
RAMP_FACTOR = 1.5
LONGEST_S = 120.0
"""A drive whose ramp is unknown and that keeps slowing down is believed this long."""
RESEND_S = 0.5
"""A drive that is slowing down is told again this often: harmless, and a lost stop costs no more than this."""
LOOK_S = 0.05
BLIND_SENDS = 3
"""DF800 shows nothing: three times, then "acknowledged, not confirmable" (matrix 6.4)."""


@dataclass(slots=True)
class _Progress:
    """When the drive was last seen to slow down."""

    since: float
    lowest_hz: float | None = None

    def note(self, talk: Talk, now: float) -> None:
        """A lower frequency than ever seen in this stop, or a decelerating state, is progress."""
        reading = talk.book.latest.get("output_frequency")
        value = None if reading is None else reading.value
        if isinstance(value, int | float) and (self.lowest_hz is None or value < self.lowest_hz):
            if self.lowest_hz is not None:
                self.since = now
            self.lowest_hz = float(value)
        if talk.verdict.state in (DriveState.DECELERATING, DriveState.BRAKING):
            self.since = now


def stop(talk: Talk, how: Stop = Stop.STOP, *, wait_for_it: bool = True) -> Conversation[Outcome]:
    """Stop, and say how far that is known. Never raises for what the bus or the drive does.

    ``wait_for_it`` False returns once the drive has answered the stop (or after its resends): unconfirmed, and so said.
    """
    outcome = yield from _stop(talk, how, wait_for_it)
    talk.may_turn = talk.may_turn and not outcome.done
    return outcome


def _stop(talk: Talk, how: Stop, wait_for_it: bool) -> Conversation[Outcome]:
    begun = (yield from look()).now
    answered = yield from send_stop(talk, how)
    if not talk.dialect.can_tell:
        return (yield from _blind(talk, how, answered))
    if not wait_for_it:
        key = "drives.stop_answered" if answered else "drives.stop_unanswered"
        return talk.outcome(OutcomeWord.UNKNOWN, key)
    return (yield from _until_seen(talk, how, begun))


def send_stop(talk: Talk, how: Stop) -> Conversation[bool]:
    """One stop and what must follow it, after the other drives' stops. True where the drive answered and did not refuse."""
    answered = False
    for place, request in enumerate(talk.dialect.stop(how)):
        answer: Answer = yield from talk.ask(request, Lane.COMMAND if place else Lane.STOP, WriteClass.ABSOLUTE)
        if place == 0:
            accepted = answer.reply is not None and talk.dialect.refusal(answer.reply) is None
            answered = answer.error is None and accepted
    return answered


def _blind(talk: Talk, how: Stop, answered: bool) -> Conversation[Outcome]:
    """A drive without a run status: repeated, then said to be unconfirmable (ruling 1, T17)."""
    for _ in range(BLIND_SENDS - 1):
        if not answered:
            yield from talk.fence()  # the answer mirrors the stop: a read settles whether the adapter echoes (F03)
        yield from wait(LOOK_S)
        answered = (yield from send_stop(talk, how)) or answered
    if answered:
        return talk.outcome(OutcomeWord.ACKNOWLEDGED, "drives.stop_acknowledged")
    return talk.outcome(OutcomeWord.UNKNOWN, "drives.stop_unconfirmed", state=DriveState.UNKNOWN)


def _until_seen(talk: Talk, how: Stop, begun: float) -> Conversation[Outcome]:
    """Look, and send again, until two fenced reads show the output off or patience ends."""
    progress = _Progress(begun)
    last_sent = begun
    ramp = talk.memory.deceleration_s
    while True:
        yield from talk.judged(patience=0)
        now = (yield from look()).now
        if talk.verdict.state.output_off and _shown(talk):
            return _stopped(talk)
        progress.note(talk, now)
        slowest = PATIENCE_TRANSACTIONS * talk.pace_s if isfinite(talk.pace_s) else 0.0
        patience = max(PATIENCE_S, slowest, (ramp or 0.0) * RAMP_FACTOR)
        if now - progress.since > patience or now - begun > max(LONGEST_S, patience):
            return talk.outcome(OutcomeWord.UNKNOWN, "drives.stop_unconfirmed", state=talk.verdict.state)
        if progress.since < now or now - last_sent >= RESEND_S:
            yield from send_stop(talk, how)
            last_sent = now
        yield from wait(LOOK_S)


def _shown(talk: Talk) -> bool:
    """A fault or an uncharged bus ends a stop by itself; else the family's own sign of it counts too."""
    state = talk.verdict.state
    return state in (DriveState.FAULT, DriveState.NOT_READY) or talk.dialect.stop_seen(talk.book)


def _stopped(talk: Talk) -> Outcome:
    state = talk.verdict.state
    plain = state in (DriveState.STOPPED, DriveState.EMERGENCY_STOPPED)
    key = "drives.stop_confirmed" if plain else "drives.output_off"
    return talk.outcome(OutcomeWord.CONFIRMED, key, state=state)
