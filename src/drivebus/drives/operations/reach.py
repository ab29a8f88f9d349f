"""Waiting until the drive reports running at the set frequency; deadline and tolerance come from its ramp. Pure."""

from __future__ import annotations

from dataclasses import replace

from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.steps import DriveOperation, get_bus_conditions, wait
from drivebus.drives.state import DriveState, Outcome, OutcomeStatus
from drivebus.errors import DrivebusError, TargetNotReached

SPEED_POLL_INTERVAL_S = 0.1
"""Between two looks."""
RAMP_SLACK_S = 2.0
RAMP_FACTOR = 1.5
"""RELIABILITY 4, effect check: within t_acc x 1.5 + 2 s."""
DEFAULT_RAMP_TIMEOUT_S = 60.0
"""Deadline where the model does not tell its ramp; ``timeout_s`` overrides it."""
SPEED_TOLERANCE = 0.005
"""Of the set frequency: a half percent, but never less than two steps of what the drive reports."""


def speed_tolerance_hz(talk: OperationContext, frequency_hz: float) -> float:
    """How near is "at" the set frequency."""
    step = talk.dialect.profile.signals["output_frequency"].scale.factor
    return max(2.0 * step, SPEED_TOLERANCE * frequency_hz)


def ramp_timeout_s(acceleration_s: float | None, timeout_s: float | None) -> float:
    """How long a ramp may take."""
    if timeout_s is not None:
        return timeout_s
    return DEFAULT_RAMP_TIMEOUT_S if acceleration_s is None else acceleration_s * RAMP_FACTOR + RAMP_SLACK_S


def wait_at_speed(
    talk: OperationContext, frequency_hz: float, outcome: Outcome, timeout_s: float | None
) -> DriveOperation[Outcome]:
    """The outcome once the drive runs at ``frequency_hz``. Raises TargetNotReached with what it reports instead."""
    around = yield from get_bus_conditions()
    generation = around.stop_epoch
    limit_s = ramp_timeout_s(talk.drive.acceleration_s, timeout_s)
    until = around.now + limit_s
    near_hz = speed_tolerance_hz(talk, frequency_hz)
    while True:
        error = yield from talk.read_verified_state()
        around = yield from get_bus_conditions()
        if around.stop_epoch != generation:
            raise talk.superseded_error()
        state, output = talk.derived.state, _output_hz(talk)
        if state is DriveState.RUNNING and output is not None and abs(output - frequency_hz) <= near_hz:
            key = "drives.running_at"
            done = talk.outcome(OutcomeStatus.CONFIRMED, key, frequency_hz=frequency_hz, output_hz=output)
            notes = tuple(note for note in outcome.notes if note[0] != "drives.setpoint_not_shown")
            return replace(done, notes=notes)  # running at it shows it
        if state.output_off or around.now > until:
            raise _not_reached_error(talk, frequency_hz, output, limit_s, error)
        yield from wait(SPEED_POLL_INTERVAL_S)


def _output_hz(talk: OperationContext) -> float | None:
    """Both of the last two reads must be there; the newer one counts."""
    pair = talk.reading_pairs.pair("output_frequency")
    value = None if pair is None else pair[1].value
    return float(value) if isinstance(value, int | float) else None


def _not_reached_error(
    talk: OperationContext, frequency_hz: float, output_hz: float | None, limit_s: float, error: DrivebusError | None
) -> TargetNotReached:
    state = talk.derived.state
    key = "drives.not_reached" if error is None else "drives.not_reached_silent"
    failure = TargetNotReached(
        key, expected_hz=frequency_hz, found_hz=output_hz, state=state, limit_s=round(limit_s, 1)
    )
    word = OutcomeStatus.FAILED if error is None else OutcomeStatus.UNKNOWN
    failure.outcome = talk.outcome(word, key, **failure.params)
    return failure
