"""Pre-flight check: read whether a drive accepts commands from the bus, and name each parameter that forbids it."""

from __future__ import annotations

from typing import Any

from drivebus.drives.context import Preflight, UnmetPrecondition
from drivebus.drives.dialects.base import Dialect, Rejection
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.steps import DriveOperation, UpdateStore, get_bus_conditions
from drivebus.errors import DrivebusError, PreflightError, StartInhibited
from drivebus.profiles.model import MAXIMUM_FREQUENCY, Parameter, Precondition
from drivebus.values import Quality, Text, bilingual_text


def read_preflight(op: OperationContext) -> DriveOperation[Preflight]:
    """Read every precondition of the profile, and the ramp times where the profile names them.

    Raises PreflightError where the drive does not answer, StartInhibited where it names another model.
    """
    yield from _check_identity_code(op)
    satisfied: list[str] = []
    unmet: list[UnmetPrecondition] = []
    unreadable: list[tuple[str, Text]] = []
    for condition in op.dialect.profile.preconditions:
        if condition.unreadable is not None:
            unreadable.append((condition.notation, condition.unreadable))
            continue
        parameter = op.dialect.profile.parameters[condition.notation]
        reply = yield from read_parameter_reply(op, parameter, "drives.preflight_unread")
        raw = op.dialect.parameter_raw(reply)
        if raw in condition.accepted:
            satisfied.append(condition.notation)
        else:
            unmet.append(_unmet(op.dialect, condition, reply))
    if not unmet:
        yield from _read_maximum_frequency(op)
    yield from _read_ramp_times(op)
    yield from op.void_checks_after_contact_loss()  # the reply to the first read may have shown it
    conditions = yield from get_bus_conditions()
    preflight = Preflight(tuple(satisfied), tuple(unmet), tuple(unreadable), conditions.now)
    op.drive.preflight = preflight
    return preflight


def record_model(op: OperationContext) -> DriveOperation[None]:
    """Record that a drive of this model is started here, so that its stop is sent also where its replies are lost."""
    drive, model = op.drive, op.dialect.profile.model
    if drive.model_key is None or drive.was_this_model or op.dialect.model_check() is not None:
        return
    yield UpdateStore(drive.model_key, lambda _: model)
    drive.was_this_model = True


def ensure_preflight(op: OperationContext) -> DriveOperation[Preflight]:
    """Return a passed pre-flight check; read it unless that was done.

    A drive without a run status is read each time, and so is one whose setpoint is a share of a maximum that it
    reports: another maximum makes the same word another speed. Raises PreflightError naming each unmet parameter with
    its keypad step.
    """
    earlier = op.drive.preflight
    share = op.dialect.profile.setpoint_share
    is_lasting = op.dialect.reports_run_state and (share is None or share.maximum is None)
    fresh = earlier is not None and earlier.passed and is_lasting
    preflight = earlier if fresh and earlier is not None else (yield from read_preflight(op))
    if not preflight.passed:
        refused = all(precondition.found is None for precondition in preflight.unmet)
        raise PreflightError(
            "drives.preflight_refused" if refused else "drives.preflight",
            model=op.dialect.profile.model,
            station=op.dialect.address,
            parameters=tuple(precondition.notation for precondition in preflight.unmet),
            steps=keypad_steps(preflight.unmet),
        )
    return preflight


def read_raw_parameter(op: OperationContext, parameter: Parameter) -> DriveOperation[int | None]:
    """Return the raw word of a parameter, None where it is rejected. Raises PreflightError without a reply."""
    return op.dialect.parameter_raw((yield from read_parameter_reply(op, parameter, "drives.setting_unread")))


def read_parameter_reply(op: OperationContext, parameter: Parameter, error_key: str) -> DriveOperation[Any]:
    """Return the reply to the read of a parameter. Raises PreflightError with ``error_key`` without one."""
    request = op.dialect.read_parameter(parameter)
    error: DrivebusError | None = None
    if op.dialect.needs_sync(request):
        error = yield from op.sync(avoid=request)
    if error is None:
        result = yield from op.transact(request)
        if result.error is None:
            return result.reply
        error = result.error if isinstance(result.error, DrivebusError) else None
    problem = Text.per_language(error.text) if error is not None else ""
    raise PreflightError(error_key, station=op.dialect.address, notation=parameter.notation, problem=problem) from error


def _check_identity_code(op: OperationContext) -> DriveOperation[None]:
    """Read the code of the model. Raises StartInhibited where it is that of another one.

    A stop does not wait for it, because the models that share the codes share the command word.
    """
    codes, model = op.dialect.profile.identity_codes, op.dialect.profile.model
    if codes is None:
        return
    for request in op.dialect.identity_reads():
        if (yield from op.sync()) is not None:
            return
        result = yield from op.transact(request)
        # No reply and an unknown code prove nothing: other models with this map may have another code, or none.
        code = None if result.error is not None else op.dialect.parameter_raw(result.reply)
        if code is not None and codes.names_other(code, model):
            models = " / ".join(codes.models[code])
            raise StartInhibited("drives.other_model", station=op.dialect.address, model=model, code=code, named=models)


def recheck_maximum_frequency(op: OperationContext) -> DriveOperation[None]:
    """Read the maximum frequency again, of which the setpoint that was sent is a share.

    Raises StartInhibited where it is not the one that the word was computed with, PreflightError where it is unknown.
    """
    share = op.dialect.profile.setpoint_share
    if share is None or share.maximum is None:
        return
    before_hz = op.dialect.options[MAXIMUM_FREQUENCY]
    yield from _read_maximum_frequency(op)
    now_hz = op.dialect.options[MAXIMUM_FREQUENCY]
    if now_hz != before_hz:
        raise StartInhibited("drives.maximum_changed", notation=share.maximum, before_hz=before_hz, now_hz=now_hz)


def _read_maximum_frequency(op: OperationContext) -> DriveOperation[None]:
    """Read the frequency that full scale of the setpoint means. Raises PreflightError where it stays unknown."""
    share = op.dialect.profile.setpoint_share
    if share is None or share.maximum is None:
        return
    op.dialect.options[MAXIMUM_FREQUENCY] = 0
    parameter = op.dialect.profile.parameters[share.maximum]
    raw = yield from read_raw_parameter(op, parameter)
    reading = None if raw is None else op.dialect.parameter_reading(parameter, raw, None)
    found_hz = reading.value if reading is not None and reading.quality is Quality.GOOD else None
    lowest_hz, highest_hz = parameter.minimum or 0, min(share.highest_hz, parameter.maximum or share.highest_hz)
    if not isinstance(found_hz, int | float) or found_hz <= 0 or not lowest_hz <= found_hz <= highest_hz:
        raise PreflightError(
            "drives.maximum_unknown",
            station=op.dialect.address,
            notation=share.maximum,
            found=found_hz,
            limit_hz=share.highest_hz,
        )
    op.dialect.options[MAXIMUM_FREQUENCY] = float(found_hz)


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


def _unmet(dialect: Dialect, condition: Precondition, reply: Any) -> UnmetPrecondition:
    raw = dialect.parameter_raw(reply)
    why = None
    if raw is None:
        why = (dialect.rejection(reply) or Rejection("drives.item_not_echoed", None)).text
    return UnmetPrecondition(condition.notation, raw, condition.accepted, condition.keypad, why)


def keypad_steps(unmet: tuple[UnmetPrecondition, ...]) -> Text:
    """Return the value of each unmet parameter and the keypad step that corrects it."""
    return Text.join([_precondition_sentence(precondition) for precondition in unmet], "sentences")


def _precondition_sentence(unmet: UnmetPrecondition) -> Text:
    key = "drives.precondition_unmet" if unmet.rejection is None else "drives.precondition_refused"
    return bilingual_text(key, notation=unmet.notation, found=unmet.found, keypad=unmet.keypad, why=unmet.rejection)
