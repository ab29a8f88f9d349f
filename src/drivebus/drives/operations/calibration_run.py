"""Run of a calibration step: forward at a raw word that is within the cap, then a stop."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from drivebus.drives.dialects.base import StopMode
from drivebus.drives.dialects.setpoint_step import UNCALIBRATED_CAP_HZ
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.preflight import ensure_preflight
from drivebus.drives.operations.preparation import prepare_start
from drivebus.drives.operations.setpoint import write_setpoint
from drivebus.drives.operations.start import confirm_start, send_frames
from drivebus.drives.operations.steps import DriveOperation, get_bus_conditions, wait
from drivebus.drives.operations.stop import stop
from drivebus.drives.outcome import Outcome, OutcomeStatus
from drivebus.drives.permissives import CommandKind, DriveCommand, state_inhibit
from drivebus.drives.state import Direction, DriveState
from drivebus.errors import BusError, LimitError, ProtocolError, TargetNotReached
from drivebus.values import Text, bilingual_text

T = TypeVar("T")

CALIBRATION_RUN_S = 3.0  # time to reach 5 Hz and to observe the motor
RUN_POLL_INTERVAL_S = 0.1  # pause between two verified states of the running motor


def run_at_word(
    op: OperationContext, word: int, direction: Direction | None, measure: Callable[[], DriveOperation[T | None]]
) -> DriveOperation[T]:
    """Run once at a raw word, measure, and stop. The word means at most 5 Hz under every scale that is left.

    Raises TargetNotReached where nothing was measured, also because a read failed, or the stop is not confirmed, and
    every error of ``run``.
    """
    op.drive.require_capability("run")
    op.drive.check_direction(direction)
    if op.drive.maximum_hz < UNCALIBRATED_CAP_HZ:
        raise LimitError("drives.above_maximum", frequency_hz=UNCALIBRATED_CAP_HZ, limit_hz=op.drive.maximum_hz)
    op.limits_checked = True
    if op.drive.preflight is not None:  # the user may have been away for long: a reply shows a loss of contact
        yield from op.read_verified_state()
        yield from op.void_checks_after_contact_loss()
    yield from ensure_preflight(op)
    error = yield from op.read_verified_state()
    if error is not None:
        raise error
    if op.dialect.reports_run_state and op.derived.state is not DriveState.STOPPED:
        raise state_inhibit(op.derived, CommandKind.START)
    if not op.dialect.start_includes_setpoint:
        yield from prepare_start(op)
        yield from _write_word(op, word, direction)
    conditions = yield from op.check_deadline()
    command = op.create_command(CommandKind.START, conditions)
    frames = op.dialect.start(direction, word)
    lost_before = op.lost_replies
    result = yield from send_frames(op, command, frames)
    if not result.sent and result.error is not None:
        raise result.error
    started = yield from confirm_start(op, command, frames, direction, answered=result.error is None)
    measured: T | None = None
    began = Text.per_language(started.text)
    interrupted = None
    if started.status is OutcomeStatus.CONFIRMED:
        interrupted = yield from _keep_running(op, command)
        began = interrupted or began
    if started.status is OutcomeStatus.CONFIRMED and interrupted is None:
        try:
            measured = yield from measure()
            if op.lost_replies > lost_before:
                measured, began = None, bilingual_text("drives.start_interrupted")
        except (BusError, ProtocolError, TargetNotReached) as unread:  # the motor turns: the stop comes first
            began = Text.per_language(unread.text)
    stopped = yield from stop(op, StopMode.STOP)
    op.age.checks_started_at = (yield from get_bus_conditions()).now  # the checks of a further run begin here
    if measured is None or stopped.status is not OutcomeStatus.CONFIRMED:
        raise _failure(word, began, stopped)
    return measured


def _keep_running(op: OperationContext, command: DriveCommand) -> DriveOperation[Text | None]:
    """Let the motor reach its frequency, and return why its run is not that of the start, None where it is.

    It is read all the time, so that a missing reply shows: a drive that was without power for a moment may run again by
    itself, at the frequency of its keypad, which would pass for another scale. Raises Superseded.
    """
    ends_at = (yield from get_bus_conditions()).now + CALIBRATION_RUN_S
    while (now := (yield from op.check_not_superseded(command))) < ends_at:
        if op.dialect.reports_run_state:
            error = yield from op.read_verified_state(allowed_failures=0)
            if error is not None:
                return Text.per_language(error.text)
            if op.derived.state.output_off:
                return bilingual_text("drives.started_and_stopped", state=op.derived.state)
        yield from wait(min(RUN_POLL_INTERVAL_S, ends_at - now))
    return None


def _write_word(op: OperationContext, word: int, direction: Direction | None) -> DriveOperation[None]:
    """Write the word that the start does not carry. Raises TargetNotReached where the drive may have another one."""
    conditions = yield from op.check_deadline()
    start = op.create_command(CommandKind.START, conditions)
    yield from op.request_permit(start, op.dialect.start(direction, word)[0])  # otherwise no word is written
    command = op.create_command(CommandKind.SETPOINT, conditions)
    written = yield from write_setpoint(op, command, word, op.dialect.setpoint_frequency(word))
    if not written.succeeded:
        raise _failure(word, Text.per_language(written.text), written)
    yield from op.check_not_superseded(command)
    error = yield from op.read_verified_state()
    if error is not None:
        raise error


def _failure(word: int, start_text: Text, last: Outcome) -> TargetNotReached:
    ended = Text.per_language(last.text)
    failure = TargetNotReached("drives.calibration_run_failed", word=f"{word:04X}H", began=start_text, ended=ended)
    failure.outcome = last
    return failure
