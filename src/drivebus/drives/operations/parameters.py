"""Read and write parameters by the manual's notation; every write is read back."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

from drivebus.drives.dialects.base import without_item_echo
from drivebus.drives.operations.context import OperationContext, with_note
from drivebus.drives.operations.parameter_write import (
    CheckedWrite,
    check_writes,
    confirmation_needed,
    display_value,
    may_become_unreachable,
    may_move,
    number_of,
    undescribed_note,
)
from drivebus.drives.operations.preflight import read_raw_parameter
from drivebus.drives.operations.steps import DriveOperation, get_bus_conditions, wait
from drivebus.drives.outcome import Outcome, OutcomeStatus
from drivebus.drives.permissives import CommandKind
from drivebus.errors import (
    BusError,
    CapabilityError,
    ConfigurationError,
    DrivebusError,
    DriveError,
    PreflightError,
    ProtocolError,
)
from drivebus.profiles.model import Parameter, Signal
from drivebus.profiles.notation import require_entries
from drivebus.user_input import parse_hex_word
from drivebus.values import Reading, Text, bilingual_text, missing_reading

_WRITTEN_KEYS = frozenset(
    {
        "drives.write_confirmed",
        "drives.write_acknowledged",
        "drives.write_unreachable",
        "drives.save_acknowledged",
    }
)
"""Keys of the notes about a parameter that was written; not of one that had the value already."""
READ_BACK_TRIES = 3
READ_BACK_PAUSE_S = 0.05  # an EEPROM takes a moment: pause before a repeated read-back


def read_values(op: OperationContext, names: tuple[str, ...]) -> DriveOperation[dict[str, Reading]]:
    """Read parameters and signals by any of their names. Raises ProfileError for unknown names, before sending."""
    op.drive.require_capability("read")
    readings: dict[str, Reading] = {}
    for name, entry in require_entries(op.dialect.profile, names).items():
        readings[name] = yield from (
            _read_signal(op, entry) if isinstance(entry, Signal) else _read_parameter(op, entry)
        )
    return readings


def _read_signal(op: OperationContext, signal: Signal) -> DriveOperation[Reading]:
    yield from op.sync()
    for request, _ in op.dialect.polls((signal.name,)):
        result = yield from op.read(request)
        if result.error is not None:
            return missing_reading("drives.no_answer", signal.unit)
    return op.reading_pairs.latest.get(signal.name) or missing_reading("drives.not_reported", signal.unit)


def _read_parameter(op: OperationContext, parameter: Parameter) -> DriveOperation[Reading]:
    if not parameter.readable:
        return missing_reading("drives.write_only", parameter.unit)
    request = op.dialect.read_parameter(parameter)
    error = (yield from op.sync(avoid=request)) if op.dialect.needs_sync(request) else None
    if error is not None:
        return missing_reading("drives.no_answer", parameter.unit)
    result = yield from op.transact(request)
    if result.error is not None:
        return missing_reading("drives.no_answer", parameter.unit)
    raw = op.dialect.parameter_raw(result.reply)
    if raw is None:
        return missing_reading(_missing_reason(op, result.reply), parameter.unit)
    reading = op.dialect.parameter_reading(parameter, raw, result.received_at)
    return reading if op.dialect.names_parameter(result.reply) else without_item_echo(reading)


def _missing_reason(op: OperationContext, reply: Any) -> str:
    """Return the i18n key of the reason why a reply has no value.

    In a fault a C320 replies 0 also to a read that it did not execute.
    """
    is_named = op.dialect.names_parameter(reply) or op.dialect.rejection(reply) is not None
    return op.dialect.read_rejection_key(reply) if is_named else "drives.item_not_echoed"


def write_values(
    op: OperationContext, values: Mapping[str, float | str], *, save: bool, force: bool = False
) -> DriveOperation[Outcome]:
    """Write parameters one after the other, up to the first that does not succeed.

    ``save`` and ``force`` are those of ``Drive.write``. Raises before sending: ProfileError, CapabilityError (no such
    parameter, read-only, ``save`` needed), LimitError, ConfirmationRequired, EepromBudgetExceeded, Expired,
    ConfigurationError (store failure).
    """
    checked = check_writes(op.dialect, values)
    op.drive.require_capability("write")
    support = op.dialect.profile.write_support
    if not save and not support.ram:
        raise CapabilityError("drives.save_needed", model=op.dialect.profile.model)
    if save and not support.eeprom:
        raise CapabilityError("drives.cannot", model=op.dialect.profile.model, what="save")
    outcome = op.outcome(OutcomeStatus.CONFIRMED, "drives.nothing_to_write")
    notes = outcome.notes
    yield from op.start_clock()
    for write in checked:
        needed = confirmation_needed(op.dialect, write)
        if needed is not None and not force:
            raise needed
        if save and not write.parameter.readable:
            raise CapabilityError("drives.not_saved", notation=write.parameter.notation)
    for place, write in enumerate(checked, 1):
        try:
            outcome = yield from _write_one(op, write, save=save)
        except (BusError, DriveError, ConfigurationError) as withheld:  # of a write that was not sent
            if not notes:
                raise
            outcome = op.outcome(OutcomeStatus.FAILED, "drives.not_written", why=withheld, **_message_params(write))
        outcome = replace(outcome, notes=(*notes, *outcome.notes))
        if not outcome.succeeded:
            return _with_unsent(outcome, checked[place:])
        outcome = with_note(outcome, outcome.key, **outcome.params)
        caution = undescribed_note(write)
        outcome = with_note(outcome, caution, **_message_params(write)) if caution else outcome
        notes = outcome.notes
        op.age.checks_started_at = (yield from get_bus_conditions()).now
    return outcome


def written_texts(outcome: Outcome) -> list[Text]:
    """Return the sentences of the parameters that a command wrote, also one that failed later."""
    return [bilingual_text(key, **params) for key, params in outcome.notes if key in _WRITTEN_KEYS]


def _with_unsent(outcome: Outcome, unsent: list[CheckedWrite]) -> Outcome:
    """Return an outcome with a note for each write that was not sent because an earlier one did not succeed."""
    for write in unsent:
        outcome = with_note(outcome, "drives.write_unsent", **_message_params(write))
    return outcome


def _message_params(write: CheckedWrite) -> dict[str, object]:
    """Return the message parameters of a write."""
    unit = f" {write.parameter.unit}" if write.parameter.unit and not isinstance(write.value, str) else ""
    return {"notation": write.parameter.notation, "value": write.value, "unit": unit}


def _write_one(op: OperationContext, write: CheckedWrite, *, save: bool) -> DriveOperation[Outcome]:
    notation, budget = write.parameter.notation, op.drive.eeprom_budget
    params = _message_params(write)
    present_raw = (yield from read_raw_parameter(op, write.parameter)) if save and write.parameter.readable else None
    if save:
        if present_raw == write.raw and not budget.count(notation).ram_written:
            return op.outcome(OutcomeStatus.CONFIRMED, "drives.write_skipped", **params)
        conditions = yield from op.check_deadline()
        yield from budget.consume(notation, conditions.day)
    else:
        yield from budget.mark_ram_only(notation)
    if not write.parameter.readable:
        # the reply mirrors the write and no read follows: the probe shows that the port has no echo
        error = yield from op.sync()
        if error is not None:
            raise PreflightError("drives.not_written", why=error, **params) from error
    conditions = yield from op.check_deadline()
    kind = CommandKind.INPUTS if may_move(op.dialect, write) else CommandKind.WRITE
    command = op.create_command(kind, conditions)
    result = yield from op.send_command(command, op.dialect.write_parameter(write.parameter, write.raw, save=save))
    refused = op.rejected_outcome(result, **params)
    if refused is not None:
        return refused
    outcome = yield from _read_back(op, write, answered=result.error is None, params=params)
    if present_raw == write.raw and outcome.status is OutcomeStatus.CONFIRMED:
        # RAM held the value before it was saved: reading it back proves nothing about the EEPROM
        outcome = op.unverifiable_outcome(
            "drives.save_acknowledged", "drives.save_unknown", answered=result.error is None, **params
        )
    if isinstance(result.error, ProtocolError) and not outcome.succeeded:
        outcome = with_note(outcome, "drives.write_reply", why=result.error)
    if save and outcome.succeeded:
        with suppress(ConfigurationError):  # unrecorded, the next save of this value is not skipped: safe
            yield from budget.mark_saved(notation)
    return outcome


def _read_back(
    op: OperationContext, write: CheckedWrite, *, answered: bool, params: dict[str, object]
) -> DriveOperation[Outcome]:
    """Read the value back behind a sync probe, by another request than the write, whose echo proves nothing."""
    if not write.parameter.readable:
        return op.unverifiable_outcome(
            "drives.write_acknowledged", "drives.write_unanswered", answered=answered, **params
        )
    raw: int | None = None
    error: DrivebusError | None = None
    for attempt in range(READ_BACK_TRIES):
        if attempt:
            yield from wait(READ_BACK_PAUSE_S)
        try:
            raw, error = (yield from _synced_raw(op, write.parameter)), None
        except PreflightError as silent:
            error = silent
        if raw == write.raw and error is None:
            return op.outcome(OutcomeStatus.CONFIRMED, "drives.write_confirmed", **params)
    if error is not None and answered and may_become_unreachable(op.dialect, write):
        return op.outcome(OutcomeStatus.ACKNOWLEDGED, "drives.write_unreachable", **params)
    if op.port_error is not None:
        why = Text.per_language(op.port_error.text)
        return op.outcome(OutcomeStatus.UNKNOWN, "drives.write_port_lost", why=why, **params)
    if error is not None or raw is None:
        why = bilingual_text("drives.read_refused") if error is None else error.params["problem"]
        return op.outcome(OutcomeStatus.UNKNOWN, "drives.write_unknown", why=why, **params)
    number = number_of(op.dialect, write.parameter, raw)
    is_word = isinstance(write.value, str) and parse_hex_word(write.value) is not None
    reported = f"{raw:04X}H" if is_word or number is None else display_value(write.parameter, number, number)
    return op.outcome(OutcomeStatus.FAILED, "drives.write_differs", found=reported, **params)


def _synced_raw(op: OperationContext, parameter: Parameter) -> DriveOperation[int | None]:
    request = op.dialect.read_parameter(parameter)
    if not op.dialect.needs_sync(request):
        yield from op.sync(avoid=request)
    return (yield from read_raw_parameter(op, parameter))
