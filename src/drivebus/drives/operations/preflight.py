"""Pre-flight check: read whether a drive accepts commands from the bus, and name each parameter that forbids it."""

from __future__ import annotations

from drivebus.drives.context import Preflight, UnmetPrecondition
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.steps import DriveOperation, get_bus_conditions
from drivebus.errors import DrivebusError, PreflightError
from drivebus.profiles.model import Parameter, Precondition
from drivebus.values import Quality, Text


def read_preflight(op: OperationContext) -> DriveOperation[Preflight]:
    """Read every precondition of the profile, and the ramp times where the profile names them.

    Raises PreflightError where the drive does not answer.
    """
    holds: list[str] = []
    missing: list[UnmetPrecondition] = []
    unreadable: list[tuple[str, Text]] = []
    for condition in op.dialect.profile.preconditions:
        if condition.unreadable is not None:
            unreadable.append((condition.notation, condition.unreadable))
            continue
        raw = yield from read_raw_parameter(op, op.dialect.profile.parameters[condition.notation])
        if raw in condition.accepted:
            holds.append(condition.notation)
        else:
            missing.append(_unmet(condition, raw))
    yield from _read_ramp_times(op)
    conditions = yield from get_bus_conditions()
    found = Preflight(tuple(holds), tuple(missing), tuple(unreadable), conditions.now)
    op.drive.preflight = found
    return found


def ensure_preflight(op: OperationContext) -> DriveOperation[Preflight]:
    """Return a passed pre-flight check; read it unless that was done. A drive without a run status is read each time.

    Raises PreflightError naming each unmet parameter with its keypad step.
    """
    known = op.drive.preflight
    fresh = known is not None and known.passed and op.dialect.reports_run_state
    found = known if fresh and known is not None else (yield from read_preflight(op))
    if not found.passed:
        raise PreflightError(
            "drives.preflight",
            model=op.dialect.profile.model,
            station=op.dialect.address,
            parameters=", ".join(m.notation for m in found.unmet),
            steps=_keypad_steps(found.unmet),
        )
    return found


def read_raw_parameter(op: OperationContext, parameter: Parameter) -> DriveOperation[int | None]:
    """Return the raw word of a parameter, None where it is rejected. Raises PreflightError without a reply."""
    request = op.dialect.read_parameter(parameter)
    error: DrivebusError | None = None
    if op.dialect.needs_sync(request):
        error = yield from op.sync(avoid=request)
    if error is None:
        answer = yield from op.transact(request)
        if answer.error is None:
            return op.dialect.parameter_raw(answer.reply)
        error = answer.error if isinstance(answer.error, DrivebusError) else None
    problem = error.text() if error is not None else ""
    raise PreflightError(
        "drives.preflight_unread", station=op.dialect.address, notation=parameter.notation, problem=problem
    ) from error


def _read_ramp_times(op: OperationContext) -> DriveOperation[None]:
    """Read the ramp times, from which deadlines are computed; without them default deadlines hold."""
    notations = op.dialect.profile.ramp_notations
    if notations is None:
        return
    seconds: list[float | None] = []
    for notation in notations:
        parameter = op.dialect.profile.parameters[notation]
        raw = yield from read_raw_parameter(op, parameter)
        reading = None if raw is None else op.dialect.parameter_reading(parameter, raw, None)
        good = reading is not None and reading.quality is Quality.GOOD
        seconds.append(float(reading.value) if good and isinstance(reading.value, int | float) else None)  # type: ignore[union-attr]
    op.drive.acceleration_s, op.drive.deceleration_s = seconds


def _unmet(condition: Precondition, raw: int | None) -> UnmetPrecondition:
    return UnmetPrecondition(condition.notation, raw, condition.accepted, condition.keypad)


def _keypad_steps(missing: tuple[UnmetPrecondition, ...]) -> Text:
    """Return the value of each unmet parameter and the keypad step that corrects it, in both languages."""
    en = " ".join(f"{m.notation} reads {_raw_text(m.found)}: {m.keypad.en}" for m in missing)
    zh = "".join(f"{m.notation} 当前为 {_raw_text(m.found)}：{m.keypad.zh}" for m in missing)
    return Text(en, zh)


def _raw_text(raw: int | None) -> str:
    return "?" if raw is None else str(raw)
