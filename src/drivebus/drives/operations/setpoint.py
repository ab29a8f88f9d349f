"""Change the set frequency: confirmed by reading it back where the model shows it, otherwise acknowledged."""

from __future__ import annotations

from drivebus.drives.context import DriveContext
from drivebus.drives.dialects.base import CommandFrame
from drivebus.drives.operations.context import VERIFICATION_ROUNDS, OperationContext
from drivebus.drives.operations.preflight import ensure_preflight, recheck_maximum_frequency
from drivebus.drives.operations.steps import DriveOperation, wait
from drivebus.drives.outcome import Outcome, OutcomeStatus
from drivebus.drives.permissives import CommandKind, DriveCommand
from drivebus.drives.readings import ReadingPairs
from drivebus.drives.state import DriveState
from drivebus.errors import DrivebusError, PreflightError, StartInhibited

SETPOINT_READ_TRIES = 4  # a drive may take a moment to show a new set frequency
SETPOINT_READ_PAUSE_S = 0.05  # pause before each further try
MAXIMUM_CHANGES = 2  # a running drive gets a corrected word once where its maximum frequency was changed meanwhile


def set_frequency(op: OperationContext, frequency_hz: float) -> DriveOperation[Outcome]:
    """Change the set frequency. Raises LimitError, CapabilityError, PreflightError or StartInhibited before sending."""
    check_set_frequency(op.drive, frequency_hz)
    yield from op.start_clock()
    error = yield from op.read_verified_state()
    if error is not None and op.dialect.start_includes_setpoint:
        raise error
    yield from op.void_checks_after_contact_loss()
    preflight = op.drive.preflight
    if op.derived.state is DriveState.FAULT and (preflight is None or not preflight.passed):
        raise StartInhibited("drives.state_forbids", state=op.derived.state, kind=CommandKind.SETPOINT)
    if (yield from ensure_preflight(op)) is not preflight:
        yield from op.read_verified_state()
    conditions = yield from op.check_deadline()
    command = op.create_command(CommandKind.SETPOINT, conditions)
    op.changes_run = not op.derived.state.output_off
    for _ in range(MAXIMUM_CHANGES):
        word, actual_hz = op.check_frequency(frequency_hz)  # again: the pre-flight check reads what the word means
        outcome = yield from write_setpoint(op, command, word, actual_hz)
        try:
            yield from recheck_maximum_frequency(op)
        except StartInhibited as changed:
            failure = changed
        except PreflightError as unread:
            return op.outcome(OutcomeStatus.UNKNOWN, "drives.maximum_unconfirmed", why=unread)
        else:
            return outcome
    return op.outcome(OutcomeStatus.FAILED, failure.key, **failure.params)


def check_set_frequency(drive: DriveContext, frequency_hz: float) -> None:
    """Check what forbids a frequency without a read of the drive. Raises CapabilityError or LimitError."""
    drive.require_capability("set_frequency")
    drive.check_frequency(frequency_hz)


def write_setpoint(
    op: OperationContext, command: DriveCommand, word: int, frequency_hz: float
) -> DriveOperation[Outcome]:
    """Send the setpoint and read it back. Raises the error of a frame that was not sent."""
    frames: tuple[CommandFrame, ...] = op.dialect.set_frequency(word, op.reading_pairs)
    refused = None
    answered = True
    for frame in frames:
        result = yield from op.send_command(command, frame)
        answered = answered and result.error is None
        refused = refused or (None if result.reply is None else op.dialect.rejection(result.reply))
        if not result.sent and result.error is not None:
            raise result.error
    if refused is not None:
        return op.refused_outcome(refused)
    return (yield from read_back_setpoint(op, word, frequency_hz, answered=answered))


def read_back_setpoint(
    op: OperationContext, word: int, frequency_hz: float, *, answered: bool
) -> DriveOperation[Outcome]:
    """Compare the set frequency that the drive shows with the one that was sent."""
    requests = op.dialect.setpoint_reads()
    error: DrivebusError | None = None
    matches: bool | None = None
    for _ in range(SETPOINT_READ_TRIES if requests else 0):
        op.reading_pairs.clear("set_frequency")
        for _ in range(VERIFICATION_ROUNDS):
            error = error or (yield from op.verified_reads(requests))
        matches = None if error is not None else op.dialect.setpoint_matches(op.reading_pairs, word, frequency_hz)
        if matches or error is not None:
            break
        yield from wait(SETPOINT_READ_PAUSE_S)
    if matches:
        op.confirmed_setpoint = word, frequency_hz
        return op.outcome(OutcomeStatus.CONFIRMED, "drives.setpoint_confirmed", frequency_hz=frequency_hz)
    if matches is False and _newest_read_matches(op, word, frequency_hz):  # one read alone proves nothing
        return op.outcome(OutcomeStatus.UNKNOWN, "drives.setpoint_unknown", frequency_hz=frequency_hz)
    if matches is False:
        return _differing_outcome(op, frequency_hz)
    if answered and error is None:
        return op.outcome(OutcomeStatus.ACKNOWLEDGED, "drives.setpoint_acknowledged", frequency_hz=frequency_hz)
    return op.outcome(OutcomeStatus.UNKNOWN, "drives.setpoint_unknown", frequency_hz=frequency_hz)


def lost_setpoint_outcome(op: OperationContext) -> Outcome | None:
    """Return the outcome of a drive that no longer shows the set frequency that it had confirmed, None of any other.

    A drive that was without power for a moment has forgotten it, and runs at that of its keypad.
    """
    if op.confirmed_setpoint is None:
        return None
    word, frequency_hz = op.confirmed_setpoint
    matches = op.dialect.setpoint_matches(op.reading_pairs, word, frequency_hz)
    if matches is not False or _newest_read_matches(op, word, frequency_hz):
        return None
    op.drive.preflight = None  # its other settings may be lost too
    return _differing_outcome(op, frequency_hz)


def _differing_outcome(op: OperationContext, frequency_hz: float) -> Outcome:
    reported_hz = op.reading_pairs.latest["set_frequency"].value
    return op.outcome(OutcomeStatus.FAILED, "drives.setpoint_differs", expected_hz=frequency_hz, found_hz=reported_hz)


def _newest_read_matches(op: OperationContext, word: int, frequency_hz: float) -> bool:
    """Return whether the newest read shows the frequency that was sent, whatever the one before it shows."""
    newest = ReadingPairs()
    for _ in range(VERIFICATION_ROUNDS):
        newest.add({"set_frequency": op.reading_pairs.latest["set_frequency"]})
    return op.dialect.setpoint_matches(newest, word, frequency_hz) is True
