"""Bench proofs: open questions of a family that only the drive itself, with a person watching, can answer. Pure.

DZB100: which coding (T08). DF800: which way round the direction field is. What is proved is stored per drive.
"""

from __future__ import annotations

from dataclasses import dataclass

from drivebus.drives.dialect import Stop
from drivebus.drives.dzb import DzbDialect
from drivebus.drives.dzb_coding import CAP_HZ, CODINGS, candidates, cap_word, decoded
from drivebus.drives.gate import Kind
from drivebus.drives.jogging import send_jog
from drivebus.drives.modbus import ModbusDialect
from drivebus.drives.operation import EXTRA_ROUNDS, ROUNDS, Talk
from drivebus.drives.preflight import ensure
from drivebus.drives.setpoint import write_setpoint
from drivebus.drives.start import confirm, send
from drivebus.drives.state import Direction, Outcome, OutcomeWord
from drivebus.drives.stopping import stop
from drivebus.drives.talk import Conversation, look, wait
from drivebus.errors import CapabilityError, GateError, LimitError, NotReached

KEYPAD_HZ = 12.3
"""All four codings of it differ: 007B, 04CE, 0123, 000C."""
RUN_S = 3.0
"""A run at the cap lasts this long: time to reach 5 Hz and to be looked at."""
JOG_CAP_HZ = 5.0
JOG_S = 0.5
"""T13: no jog without a lease longer than this."""


@dataclass(frozen=True, slots=True)
class CodingFound:
    """What a proof leaves: the words read and the codings that are still possible. One: settled."""

    words: tuple[int, ...]
    codings: tuple[str, ...]

    @property
    def settled(self) -> str | None:
        return self.codings[0] if len(self.codings) == 1 else None


def query_coding(talk: Talk, keypad_hz: float = KEYPAD_HZ) -> Conversation[CodingFound]:
    """Somebody has set ``keypad_hz`` on the keypad; Q00 names the query coding. Nothing moves."""
    dialect = _dzb(talk)
    word = yield from _agreed_word(talk, dialect, 0)
    step = {coding: abs(_hz(word, coding) - keypad_hz) for coding in CODINGS}
    fits = tuple(coding for coding in CODINGS if step[coding] <= _half_step(coding))
    if not fits:
        raise NotReached("drives.coding_not_named", word=f"{word:04X}H", keypad_hz=keypad_hz)
    return CodingFound((word,), fits)


def setpoint_coding(talk: Talk, direction: Direction | None = None) -> Conversation[CodingFound]:
    """Run at the cap with a person watching, read Q00 and Q01 back, exclude codings until one is left. Always stops.

    Needs the query coding. Raises GateError without it, and whatever ``run`` raises.
    """
    dialect = _dzb(talk)
    if not dialect.can_wait():
        raise GateError("drives.query_coding_first")
    left = candidates(dialect.settings)
    words: list[int] = []
    while len(left) > 1:
        word = cap_word(left)
        seen_hz = yield from _run_and_look(talk, dialect, word, direction)
        words.append(word)
        fits = tuple(coding for coding in left if abs(_hz(word, coding) - seen_hz) <= _query_step(dialect))
        if not fits:
            raise NotReached("drives.setpoint_not_named", word=f"{word:04X}H", found_hz=seen_hz)
        if fits == left:
            break
        left = fits
    return CodingFound(tuple(words), left)


def _run_and_look(talk: Talk, dialect: DzbDialect, word: int, direction: Direction | None) -> Conversation[float]:
    """One run at a raw word; what Q00 and Q01 agree on, in Hz. Stops whatever happens."""
    talk.memory.need("run")
    talk.memory.check_direction(direction)
    if talk.memory.maximum_hz < CAP_HZ:
        raise LimitError("drives.above_maximum", frequency_hz=CAP_HZ, limit_hz=talk.memory.maximum_hz)
    talk.within_limits = True  # the word is at most 5 Hz under every coding that is left
    yield from ensure(talk)
    error = yield from talk.judged()
    if error is not None:
        raise error
    around = yield from look()
    command = talk.command(Kind.START, around)
    frames = dialect.start(direction, word)
    answer = yield from send(talk, command, frames)
    if not answer.sent and answer.error is not None:
        raise answer.error
    begun = yield from confirm(talk, command, frames, direction, answer.error is None)
    seen: float | None = None
    if begun.word is OutcomeWord.CONFIRMED:
        yield from wait(RUN_S)
        yield from talk.still_wanted(command)
        seen = yield from _seen_hz(talk, dialect)
    stopped = yield from stop(talk, Stop.STOP)
    if seen is None or stopped.word is not OutcomeWord.CONFIRMED:
        failure = NotReached("drives.proof_run_failed", word=f"{word:04X}H", began=begun.text(), ended=stopped.text())
        failure.outcome = stopped
        raise failure
    return seen


def _seen_hz(talk: Talk, dialect: DzbDialect) -> Conversation[float | None]:
    """Q00 and Q01, each read twice behind fences; None where they do not agree."""
    command = yield from _agreed_word(talk, dialect, 0)
    output = yield from _agreed_word(talk, dialect, 1)
    coding = str(dialect.settings["query_coding"])
    first, second = _hz(command, coding), _hz(output, coding)
    return second if abs(first - second) <= 2 * _query_step(dialect) else None


def _agreed_word(talk: Talk, dialect: DzbDialect, item: int) -> Conversation[int]:
    """The raw word of Q00 or Q01, two fenced reads that agree. Raises the bus's error, or NotReached."""
    requests = (dialect.query(item),)
    name = ("set_frequency", "output_frequency")[item]
    talk.book.forget(name)
    for _ in range(ROUNDS + EXTRA_ROUNDS):
        error = yield from talk.fenced_reads(requests)
        if error is not None:
            raise error
        word = talk.book.agreed(name)
        if word is not None:
            return word
    raise NotReached("drives.no_agreement", item=f"Q{item:02d}")


def _hz(word: int, coding: str) -> float:
    """Hertz of a word; infinitely wrong where the coding can't read it."""
    value = decoded(word, coding)
    return float("inf") if value is None else value


def _half_step(coding: str) -> float:
    """12.3 Hz shows as 12 Hz under hex-1."""
    return {"hex-1": 0.5, "hex-0.01": 0.005}.get(coding, 0.05)


def _query_step(dialect: DzbDialect) -> float:
    """What one digit of Q00 can hide."""
    return 2 * _half_step(str(dialect.settings["query_coding"]))


def _dzb(talk: Talk) -> DzbDialect:
    if not isinstance(talk.dialect, DzbDialect):
        raise CapabilityError("drives.cannot", model=talk.dialect.profile.model, what="coding proof")
    return talk.dialect


def direction_jog(talk: Talk, frequency_hz: float) -> Conversation[Outcome]:
    """Jog once, at most 5 Hz and 0.5 s, with the direction digits 10 as b3 b2; then a person says which way it turned.

    The jog frequency itself may be a keypad setting of the drive: set it to 5 Hz or less there first.
    """
    dialect = talk.dialect
    if not isinstance(dialect, ModbusDialect) or "direction_field" not in dialect.settings:
        raise CapabilityError("drives.cannot", model=dialect.profile.model, what="direction proof")
    if not 0.0 < frequency_hz <= JOG_CAP_HZ:
        raise LimitError("drives.above_maximum", frequency_hz=frequency_hz, limit_hz=JOG_CAP_HZ)
    word, actual_hz = talk.check_frequency(frequency_hz)
    yield from ensure(talk)
    around = yield from look()
    command = talk.command(Kind.JOG, around)
    outcome = yield from write_setpoint(talk, command, word, actual_hz)
    if not outcome.done:
        return outcome
    outcome = yield from send_jog(talk, dialect.proof_jog())
    if outcome.done:
        yield from wait(JOG_S)
        stopped = yield from stop(talk, Stop.STOP)
        if not stopped.done:
            return stopped
    return outcome


def direction_field(seen: Direction) -> str:
    """Which reading of the field the watched jog proves."""
    return "b3b2" if seen is Direction.FORWARD else "b2b3"
