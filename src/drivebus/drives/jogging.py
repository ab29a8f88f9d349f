"""Jog: the frame that begins it and the end of it. The lease around them is the shell's (``lease``). Pure.

A jog has no dead-man on these drives (T13): whoever begins one has to keep its lease alive, 500 ms at most.
"""

from __future__ import annotations

from drivebus.drives.dialect import Frame, Stop
from drivebus.drives.gate import Kind
from drivebus.drives.operation import Talk
from drivebus.drives.start import prepare, send
from drivebus.drives.state import Direction, Outcome, OutcomeWord
from drivebus.drives.stopping import send_stop, stop
from drivebus.drives.talk import Conversation, look
from drivebus.errors import LimitError

LONGEST_LEASE_S = 0.5
"""T13: no motion outlives the hand on the key by more."""


def check_lease(lease_s: float) -> float:
    """Raises LimitError for a lease that is none."""
    if not 0.0 < lease_s <= LONGEST_LEASE_S:
        raise LimitError("drives.lease_too_long", lease_s=lease_s, limit_s=LONGEST_LEASE_S)
    return lease_s


def begin(talk: Talk, frequency_hz: float | None, direction: Direction) -> Conversation[Outcome]:
    """Begin to jog from standstill; sent once. An unanswered jog is stopped at once: nobody knows whether it turns."""
    memory, dialect = talk.memory, talk.dialect
    memory.need("jog")
    memory.check_direction(direction)
    word = None if frequency_hz is None else talk.check_frequency(frequency_hz)[0]
    talk.within_limits = True  # without a frequency it is the drive's own, set on its keypad
    frames = dialect.jog(direction, word)
    yield from talk.begin()
    yield from prepare(talk)
    yield from talk.in_time()
    return (yield from send_jog(talk, frames))


def send_jog(talk: Talk, frames: tuple[Frame, ...]) -> Conversation[Outcome]:
    """The jog frame, once; whatever does not end in a yes is stopped."""
    around = yield from look()
    command = talk.command(Kind.JOG, around)
    answer = yield from send(talk, command, frames)
    refused = talk.refused(answer)
    if refused is not None:
        talk.may_turn = False
        return refused
    if answer.error is None:
        return talk.outcome(OutcomeWord.ACKNOWLEDGED, "drives.jog_begun")
    yield from end(talk)
    return talk.outcome(OutcomeWord.UNKNOWN, "drives.jog_unknown")


def end(talk: Talk) -> Conversation[Outcome]:
    """End the jog: the family's jog stop, then an ordinary stop until the drive reports standstill."""
    if talk.dialect.can_tell:
        yield from send_stop(talk, Stop.JOG_STOP)
    return (yield from stop(talk, Stop.STOP))
