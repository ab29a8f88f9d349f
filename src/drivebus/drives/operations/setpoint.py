"""``set_frequency``: absolute, read back where the model shows it, acknowledged where nothing does (ruling 1). Pure."""

from __future__ import annotations

from drivebus.drives.dialects.base import CommandFrame
from drivebus.drives.operations.context import VERIFICATION_ROUNDS, OperationContext
from drivebus.drives.operations.preflight import ensure_preflight
from drivebus.drives.operations.steps import DriveOperation, wait
from drivebus.drives.permissives import CommandKind, DriveCommand
from drivebus.drives.state import DriveState, Outcome, OutcomeStatus
from drivebus.errors import DrivebusError, StartInhibited

SETPOINT_READ_TRIES = 4
"""A drive may take a moment to show a new set frequency …"""
SETPOINT_READ_PAUSE_S = 0.05
"""… so it is looked at again after this."""


def set_frequency(talk: OperationContext, frequency_hz: float) -> DriveOperation[Outcome]:
    """Change the set frequency. Raises LimitError, CapabilityError, PreflightError or StartInhibited before sending."""
    talk.drive.require_capability("set_frequency")
    word, actual_hz = talk.check_frequency(frequency_hz)
    yield from talk.start_clock()
    error = yield from talk.read_verified_state()
    if error is not None and talk.dialect.start_includes_setpoint:
        raise error
    preflight = talk.drive.preflight
    if talk.derived.state is DriveState.FAULT and (preflight is None or not preflight.passed):
        raise StartInhibited("drives.state_forbids", state=talk.derived.state, kind=CommandKind.SETPOINT)
    if (yield from ensure_preflight(talk)) is not preflight:
        yield from talk.read_verified_state()
    around = yield from talk.check_deadline()
    command = talk.create_command(CommandKind.SETPOINT, around)
    return (yield from write_setpoint(talk, command, word, actual_hz))


def write_setpoint(
    talk: OperationContext, command: DriveCommand, word: int, frequency_hz: float
) -> DriveOperation[Outcome]:
    """Send the setpoint and read it back."""
    frames: tuple[CommandFrame, ...] = talk.dialect.set_frequency(word, talk.reading_pairs)
    refused = None
    answered = True
    for frame in frames:
        answer = yield from talk.send_command(command, frame)
        answered = answered and answer.error is None
        refused = refused or (None if answer.reply is None else talk.dialect.rejection(answer.reply))
        if not answer.sent and answer.error is not None:
            raise answer.error
    if refused is not None:
        return talk.outcome(OutcomeStatus.REFUSED, refused.key, code=refused.code)
    return (yield from read_back_setpoint(talk, word, frequency_hz, answered))


def read_back_setpoint(
    talk: OperationContext, word: int, frequency_hz: float, answered: bool
) -> DriveOperation[Outcome]:
    """What the drive shows of the set frequency after a fence."""
    requests = talk.dialect.setpoint_reads()
    error: DrivebusError | None = None
    verdict: bool | None = None
    for _ in range(SETPOINT_READ_TRIES if requests else 0):
        talk.reading_pairs.clear("set_frequency")
        for _ in range(VERIFICATION_ROUNDS):
            error = error or (yield from talk.verified_reads(requests))
        verdict = None if error is not None else talk.dialect.setpoint_matches(talk.reading_pairs, word, frequency_hz)
        if verdict or error is not None:
            break
        yield from wait(SETPOINT_READ_PAUSE_S)
    if verdict:
        return talk.outcome(OutcomeStatus.CONFIRMED, "drives.setpoint_confirmed", frequency_hz=frequency_hz)
    if verdict is False:
        found = talk.reading_pairs.latest["set_frequency"].value
        return talk.outcome(OutcomeStatus.FAILED, "drives.setpoint_differs", expected_hz=frequency_hz, found_hz=found)
    if answered and error is None:
        return talk.outcome(OutcomeStatus.ACKNOWLEDGED, "drives.setpoint_acknowledged", frequency_hz=frequency_hz)
    return talk.outcome(OutcomeStatus.UNKNOWN, "drives.setpoint_unknown", frequency_hz=frequency_hz)
