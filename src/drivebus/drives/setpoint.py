"""``set_frequency``: absolute, read back where the model shows it, acknowledged where nothing does (ruling 1). Pure."""

from __future__ import annotations

from drivebus.drives.dialect import Frame
from drivebus.drives.gate import Command, Kind
from drivebus.drives.operation import ROUNDS, Talk
from drivebus.drives.preflight import ensure
from drivebus.drives.state import DriveState, Outcome, OutcomeWord
from drivebus.drives.talk import Conversation, wait
from drivebus.errors import DrivebusError, GateError

SHOW_TRIES = 4
"""A drive may take a moment to show a new set frequency …"""
SHOW_PAUSE_S = 0.05
"""… so it is looked at again after this."""


def set_frequency(talk: Talk, frequency_hz: float) -> Conversation[Outcome]:
    """Change the set frequency. Raises LimitError, CapabilityError, PreflightError or GateError before sending."""
    talk.memory.need("set_frequency")
    word, actual_hz = talk.check_frequency(frequency_hz)
    yield from talk.begin()
    error = yield from talk.judged()
    if error is not None and talk.dialect.carries_frequency:
        raise error
    preflight = talk.memory.preflight
    if talk.verdict.state is DriveState.FAULT and (preflight is None or not preflight.passed):
        raise GateError("drives.state_forbids", state=talk.verdict.state, kind=Kind.SETPOINT)
    if (yield from ensure(talk)) is not preflight:
        yield from talk.judged()
    around = yield from talk.in_time()
    command = talk.command(Kind.SETPOINT, around)
    return (yield from write_setpoint(talk, command, word, actual_hz))


def write_setpoint(talk: Talk, command: Command, word: int, frequency_hz: float) -> Conversation[Outcome]:
    """Send the setpoint and read it back."""
    frames: tuple[Frame, ...] = talk.dialect.set_frequency(word, talk.book)
    refused = None
    answered = True
    for frame in frames:
        answer = yield from talk.act(command, frame)
        answered = answered and answer.error is None
        refused = refused or (None if answer.reply is None else talk.dialect.refusal(answer.reply))
        if not answer.sent and answer.error is not None:
            raise answer.error
    if refused is not None:
        return talk.outcome(OutcomeWord.REFUSED, refused.key, code=refused.code)
    return (yield from shown(talk, word, frequency_hz, answered))


def shown(talk: Talk, word: int, frequency_hz: float, answered: bool) -> Conversation[Outcome]:
    """What the drive shows of the set frequency after a fence."""
    requests = talk.dialect.setpoint_reads()
    error: DrivebusError | None = None
    verdict: bool | None = None
    for _ in range(SHOW_TRIES if requests else 0):
        talk.book.forget("set_frequency")
        for _ in range(ROUNDS):
            error = error or (yield from talk.fenced_reads(requests))
        verdict = None if error is not None else talk.dialect.setpoint_shown(talk.book, word, frequency_hz)
        if verdict or error is not None:
            break
        yield from wait(SHOW_PAUSE_S)
    if verdict:
        return talk.outcome(OutcomeWord.CONFIRMED, "drives.setpoint_confirmed", frequency_hz=frequency_hz)
    if verdict is False:
        found = talk.book.latest["set_frequency"].value
        return talk.outcome(OutcomeWord.FAILED, "drives.setpoint_differs", expected_hz=frequency_hz, found_hz=found)
    if answered and error is None:
        return talk.outcome(OutcomeWord.ACKNOWLEDGED, "drives.setpoint_acknowledged", frequency_hz=frequency_hz)
    return talk.outcome(OutcomeWord.UNKNOWN, "drives.setpoint_unknown", frequency_hz=frequency_hz)
