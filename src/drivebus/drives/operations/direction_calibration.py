"""Calibration of the direction field of a Modbus drive whose manual does not name the order of its bits (DF800)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

from drivebus.drives.dialects.base import StopMode
from drivebus.drives.dialects.modbus import ModbusDialect
from drivebus.drives.operations.calibration import CalibrationResult, CalibrationStep, PlannedRequests
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.jog import MAX_JOG_LEASE_S, send_jog
from drivebus.drives.operations.preflight import ensure_preflight
from drivebus.drives.operations.setpoint import write_setpoint
from drivebus.drives.operations.steps import DriveOperation, wait
from drivebus.drives.operations.stop import stop
from drivebus.drives.permissives import CommandKind
from drivebus.drives.readings import ReadingPairs
from drivebus.drives.state import Direction
from drivebus.errors import LimitError

MAX_CALIBRATION_JOG_HZ = 5.0


def calibration_jog(
    op: OperationContext, frequency_hz: float = MAX_CALIBRATION_JOG_HZ
) -> DriveOperation[CalibrationResult]:
    """Jog once, at most 5 Hz and 0.5 s, with the direction digits 10 as b3 b2; the outcome is that of its stop.

    The jog frequency itself may be a keypad setting of the drive: set it to 5 Hz or less there first. Raises LimitError
    for more than 5 Hz, and every error of ``jog``.
    """
    dialect = cast("ModbusDialect", op.dialect)
    if not 0.0 < frequency_hz <= MAX_CALIBRATION_JOG_HZ:
        raise LimitError("drives.above_maximum", frequency_hz=frequency_hz, limit_hz=MAX_CALIBRATION_JOG_HZ)
    word, actual_hz = op.check_frequency(frequency_hz)
    yield from ensure_preflight(op)
    conditions = yield from op.check_deadline()
    command = op.create_command(CommandKind.JOG, conditions)
    outcome = yield from write_setpoint(op, command, word, actual_hz)
    if outcome.succeeded:
        outcome = yield from send_jog(op, dialect.calibration_jog())
        if outcome.succeeded:
            yield from wait(MAX_JOG_LEASE_S)
            outcome = yield from stop(op, StopMode.STOP)
    return CalibrationResult(outcome=outcome)


def _options_observed(direction: Direction) -> Mapping[str, Any]:
    """Return the bit order that an observed direction shows."""
    return {"direction_field": "b3b2" if direction is Direction.FORWARD else "b2b3", "direction_calibrated": True}


def _plan(dialect: ModbusDialect) -> PlannedRequests:
    setpoint = dialect.set_frequency(dialect.setpoint_word(MAX_CALIBRATION_JOG_HZ), ReadingPairs())
    return (
        ("set_frequency", tuple(frame.request for frame in setpoint)),
        ("jog_once", tuple(frame.request for frame in dialect.calibration_jog())),
    )


STEPS = (
    CalibrationStep(
        name="direction",
        option="direction_calibrated",
        undetermined=False,
        moves=True,
        operation=calibration_jog,
        plan=_plan,
        question="calibrate.ask_jog",
        question_params={"cap_hz": MAX_CALIBRATION_JOG_HZ, "seconds": MAX_JOG_LEASE_S},
        observation_question="calibrate.ask_direction",
        observations={"f": Direction.FORWARD, "r": Direction.REVERSE},
        options_observed=_options_observed,
    ),
)
