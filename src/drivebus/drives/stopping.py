"""``stop``, ``coast``, ``quick_stop``: sent before anything else, resent until the drive reports it (ruling 5). Pure.

No check of the host ever withholds a stop: nothing here asks the gate.
"""

from __future__ import annotations

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
LONGEST_S = 120.0
"""A drive that keeps slowing down is believed this long, or as long as its own ramp takes."""
RESEND_S = 0.5
"""A drive that is slowing down is told again this often: harmless, and a lost stop costs no more than this."""
LOOK_S = 0.05
BLIND_SENDS = 3
"""DF800 shows nothing: three times, then "acknowledged, not confirmable" (matrix 6.4)."""


class Progress:
    """How a stop gets on, and when it is overdue (G07)."""

    def __init__(self, talk: Talk, begun: float, drives: int = 1) -> None:
        """``drives``: so many are stopped at once and looked at in turns."""
        self._talk, self._begun, self._drives = talk, begun, drives
        self._since = self._noted = begun

    @property
    def _slowing_at(self) -> float:
        """When the drive was last seen to slow down."""
        return max(self._since, self._talk.slowed_at or self._begun)

    def note(self, now: float) -> bool:
        """Is it slowing down? A lower frequency than ever seen in this stop since the last look, or such a state."""
        if self._talk.verdict.state in (DriveState.DECELERATING, DriveState.BRAKING):
            self._since = now
        before, self._noted = self._noted, self._slowing_at
        return self._noted > before

    @property
    def alarm_at(self) -> float:
        """Without progress for its patience, or without standstill after its ramp where that is known: unconfirmed."""
        ramp, pace = self._talk.memory.deceleration_s or 0.0, self._talk.pace_s
        patience = max(PATIENCE_S, PATIENCE_TRANSACTIONS * self._drives * pace if isfinite(pace) else 0.0)
        by_its_ramp = self._begun + PATIENCE_S + ramp
        return min(max(self._slowing_at + patience, by_its_ramp), max(self._begun + LONGEST_S, by_its_ramp))


def stop(
    talk: Talk, how: Stop = Stop.STOP, *, wait_for_it: bool = True, progress: Progress | None = None
) -> Conversation[Outcome]:
    """Stop, and say how far that is known. Never raises for what the bus or the drive does.

    ``wait_for_it`` False returns once the drive has answered the stop (or after its resends): unconfirmed, and so said.
    """
    outcome = yield from _stop(talk, how, wait_for_it, progress or Progress(talk, (yield from look()).now))
    talk.may_turn = talk.may_turn and not outcome.done
    return outcome


def _stop(talk: Talk, how: Stop, wait_for_it: bool, progress: Progress) -> Conversation[Outcome]:
    begun = (yield from look()).now
    answered = yield from send_stop(talk, how)
    if not talk.dialect.can_tell:
        return (yield from _blind(talk, how, answered))
    if not wait_for_it:
        key = "drives.stop_answered" if answered else "drives.stop_unanswered"
        return talk.outcome(OutcomeWord.UNKNOWN, key)
    return (yield from _until_seen(talk, how, begun, progress))


def send_stop(talk: Talk, how: Stop) -> Conversation[bool]:
    """One stop and what must follow it, after the other drives' stops. True where the drive answered and agreed."""
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
    return unconfirmed(talk)


def _until_seen(talk: Talk, how: Stop, last_sent: float, progress: Progress) -> Conversation[Outcome]:
    """Look, and send again, until two fenced reads show the output off or patience ends."""
    while True:
        yield from talk.judged(patience=0)
        now = (yield from look()).now
        if talk.verdict.state.output_off and _shown(talk):
            return _stopped(talk)
        slowing = progress.note(now)
        if now > progress.alarm_at:
            return unconfirmed(talk)
        if not slowing or now - last_sent >= RESEND_S:
            yield from send_stop(talk, how)
            last_sent = now
        yield from wait(LOOK_S)


def unconfirmed(talk: Talk) -> Outcome:
    """What a user is told who must go and look."""
    return talk.outcome(OutcomeWord.UNKNOWN, "drives.stop_unconfirmed", state=talk.verdict.state)


def _shown(talk: Talk) -> bool:
    """A fault or an uncharged bus ends a stop by itself; else the family's own sign of it counts too."""
    state = talk.verdict.state
    return state in (DriveState.FAULT, DriveState.NOT_READY) or talk.dialect.stop_seen(talk.book)


def _stopped(talk: Talk) -> Outcome:
    state = talk.verdict.state
    plain = state in (DriveState.STOPPED, DriveState.EMERGENCY_STOPPED)
    key = "drives.stop_confirmed" if plain else "drives.output_off"
    return talk.outcome(OutcomeWord.CONFIRMED, key, state=state)
