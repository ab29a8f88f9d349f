"""Calibration of the setpoint step: one run within the cap, while a person reads the frequency on the keypad."""

from __future__ import annotations

from drivebus.drives.dialects.base import Dialect
from drivebus.drives.dialects.setpoint_step import UNCALIBRATED_CAP_HZ, highest_safe_word, possible_steps_hz
from drivebus.drives.operations.calibration import CalibrationResult, CalibrationStep, PlannedRequests
from drivebus.drives.operations.calibration_run import CALIBRATION_RUN_S, run_at_word
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.steps import DriveOperation
from drivebus.drives.readings import ReadingPairs
from drivebus.drives.state import Direction
from drivebus.profiles.model import SETPOINT_STEP, UNDETERMINED


def run_at_safe_word(op: OperationContext, direction: Direction | None = None) -> DriveOperation[CalibrationResult]:
    """Run for 3 s at the largest word that is at most 5 Hz under every step. Always stops."""
    word = _safe_word(op.dialect)
    yield from run_at_word(op, word, direction, lambda: _still_runs(op))
    return CalibrationResult(words=(word,))


def _still_runs(op: OperationContext) -> DriveOperation[bool | None]:
    """Return whether the drive still runs; the frequency is read on its keypad, not on the bus."""
    error = yield from op.read_verified_state()
    return True if error is None and op.derived.state.driven else None


def _safe_word(dialect: Dialect) -> int:
    """Return the word for every step of the open question: a step that is already stated may be wrong."""
    return highest_safe_word(possible_steps_hz(dialect.profile, {SETPOINT_STEP: UNDETERMINED}))


def _plan(dialect: Dialect) -> PlannedRequests:
    word = _safe_word(dialect)
    before = () if dialect.start_includes_setpoint else dialect.set_frequency(word, ReadingPairs())
    planned = (("set_frequency", before), ("start", dialect.start(None, word)))
    sent = [(purpose, tuple(frame.request for frame in frames)) for purpose, frames in planned if frames]
    return (("state", dialect.state_reads()), *sent)


STEPS = (
    CalibrationStep(
        name=SETPOINT_STEP,
        option=SETPOINT_STEP,
        undetermined=UNDETERMINED,
        moves=True,
        operation=run_at_safe_word,
        plan=_plan,
        question="calibrate.ask_step",
        question_params={"cap_hz": UNCALIBRATED_CAP_HZ, "seconds": CALIBRATION_RUN_S},
        observation_question="calibrate.ask_keypad_hz",
        observations={"0": "0.01", "5": "0.1"},  # word 50 shows 0.5 Hz or 5 Hz: the first digit that is typed
        options_observed=lambda step: {SETPOINT_STEP: step},
    ),
)
