"""``read`` and ``write``: the manual's own notation or signal names; every write is read back (ruling 8, T04). Pure."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

from drivebus.drives.gate import Kind
from drivebus.drives.operation import Talk, noted
from drivebus.drives.preflight import read_raw
from drivebus.drives.state import Outcome, OutcomeWord
from drivebus.drives.talk import Conversation, look, wait
from drivebus.errors import (
    CapabilityError,
    ConfigurationError,
    DrivebusError,
    DriveError,
    Expired,
    LimitError,
    PreflightError,
)
from drivebus.profiles.model import Parameter, Signal
from drivebus.profiles.notation import find
from drivebus.reading import Reading, missing

BACK_TRIES = 3
BACK_PAUSE_S = 0.05
"""An EEPROM takes a moment: the read-back is repeated after this pause."""


@dataclass(frozen=True, slots=True)
class _Wanted:
    """One write, checked before anything is sent."""

    parameter: Parameter
    value: float
    raw: int


def read(talk: Talk, names: tuple[str, ...]) -> Conversation[dict[str, Reading]]:
    """Parameters and signals by any of their names. Raises ProfileError for a name nobody knows, before sending."""
    talk.memory.need("read")
    entries = {name: find(talk.dialect.profile, name) for name in names}
    found: dict[str, Reading] = {}
    for name, entry in entries.items():
        found[name] = yield from (_signal(talk, entry) if isinstance(entry, Signal) else _parameter(talk, entry))
    return found


def _signal(talk: Talk, signal: Signal) -> Conversation[Reading]:
    yield from talk.fence()
    for request, _ in talk.dialect.polls((signal.name,)):
        answer = yield from talk.read(request)
        if answer.error is not None:
            return missing("drives.no_answer", signal.unit)
    return talk.book.latest.get(signal.name) or missing("drives.not_reported", signal.unit)


def _parameter(talk: Talk, parameter: Parameter) -> Conversation[Reading]:
    if not parameter.readable:
        return missing("drives.write_only", parameter.unit)
    request = talk.dialect.read_parameter(parameter)
    error = (yield from talk.fence(avoid=request)) if talk.dialect.clashes(request) else None
    if error is not None:
        return missing("drives.no_answer", parameter.unit)
    answer = yield from talk.ask(request)
    if answer.error is not None:
        return missing("drives.no_answer", parameter.unit)
    raw = talk.dialect.parameter_raw(answer.reply)
    if raw is None:
        return missing("drives.refused_read", parameter.unit)
    return talk.dialect.parameter_reading(parameter, raw, answer.received_at)


def write(talk: Talk, values: Mapping[str, float], save: bool) -> Conversation[Outcome]:
    """Write parameters one after the other; the first that does not end well ends it.

    Raises before sending: ProfileError, CapabilityError (no such parameter, read-only, ``save`` needed), LimitError,
    WearBudget, Expired, ConfigurationError (the store of counts fails). The outcome's notes name every parameter.
    """
    talk.memory.need("write")
    rule = talk.dialect.profile.write_rule
    if not save and not rule.ram:
        raise CapabilityError("drives.save_needed", model=talk.dialect.profile.model)
    if save and not rule.eeprom:
        raise CapabilityError("drives.cannot", model=talk.dialect.profile.model, what="save")
    outcome = talk.outcome(OutcomeWord.CONFIRMED, "drives.nothing_to_write")
    notes = outcome.notes
    yield from talk.begin()
    for wanted in [_checked(talk, name, value) for name, value in values.items()]:
        try:
            outcome = yield from _write_one(talk, wanted, save)
        except (DriveError, Expired, ConfigurationError) as withheld:
            if not notes:
                raise
            outcome = talk.outcome(OutcomeWord.FAILED, "drives.not_written", why=withheld, **_said(wanted))
        outcome = replace(outcome, notes=notes)
        if not outcome.done:
            return outcome
        outcome = noted(outcome, outcome.key, **outcome.params)
        notes = outcome.notes
        talk.begun = (yield from look()).now
    return outcome


def _checked(talk: Talk, name: str, value: float) -> _Wanted:
    """Raises where this parameter can't be written, or not with this value."""
    model = talk.dialect.profile.model
    parameter = find(talk.dialect.profile, name)
    if isinstance(parameter, Signal):
        raise CapabilityError("drives.signal_not_written", model=model, notation=parameter.notation)
    if not parameter.writable or not parameter.listed:
        raise CapabilityError("drives.not_writable", model=model, notation=parameter.notation)
    low, high = parameter.minimum, parameter.maximum
    if (low is not None and value < low) or (high is not None and value > high):
        raise LimitError("drives.parameter_range", notation=parameter.notation, value=value, minimum=low, maximum=high)
    try:
        raw = talk.dialect.parameter_word(parameter, value)
    except ValueError as error:
        raise LimitError("drives.parameter_word", notation=parameter.notation, value=value) from error
    if parameter.choices and raw not in parameter.choices and parameter.maximum is None:
        known = ", ".join(str(choice) for choice in parameter.choices)
        raise LimitError("drives.parameter_choice", notation=parameter.notation, value=value, choices=known)
    return _Wanted(parameter, value, raw)


def _said(wanted: _Wanted) -> dict[str, object]:
    """What a sentence says of it: whole numbers where the drive's own display shows them, no blank without a unit."""
    parameter, value = wanted.parameter, wanted.value
    whole = parameter.scale.decimals == 0 and float(value).is_integer()
    unit = f" {parameter.unit}" if parameter.unit else ""
    return {"notation": parameter.notation, "value": int(value) if whole else value, "unit": unit}


def _write_one(talk: Talk, wanted: _Wanted, save: bool) -> Conversation[Outcome]:
    notation, wear = wanted.parameter.notation, talk.memory.wear
    said = _said(wanted)
    held = (yield from read_raw(talk, wanted.parameter)) if save and wanted.parameter.readable else None
    if save:
        if held == wanted.raw and not wear.count(notation).ram_written:
            return talk.outcome(OutcomeWord.CONFIRMED, "drives.write_skipped", **said)
        around = yield from talk.in_time()
        yield from wear.charge(notation, around.day)
    else:
        yield from wear.ram_only(notation)
    around = yield from talk.in_time()
    command = talk.memory.command(Kind.WRITE, around)
    answer = yield from talk.act(command, talk.dialect.write_parameter(wanted.parameter, wanted.raw, save))
    refused = talk.refused(answer, **said)
    if refused is not None:
        return refused
    outcome = yield from _read_back(talk, wanted, answer.error is None, said)
    if held == wanted.raw and outcome.word is OutcomeWord.CONFIRMED:
        # RAM held the value before it was saved: reading it back proves nothing of the EEPROM (rulings 1 and 8)
        outcome = talk.unseen(answer.error is None, "drives.save_acknowledged", "drives.save_unknown", **said)
    if save and outcome.done:
        with suppress(ConfigurationError):  # not noted, the next save of this value is not skipped: safe
            yield from wear.saved(notation)
    return outcome


def _read_back(talk: Talk, wanted: _Wanted, answered: bool, said: dict[str, object]) -> Conversation[Outcome]:
    """Through a different request, behind a fence (RELIABILITY 4: removes echo forgery)."""
    if not wanted.parameter.readable:
        return talk.unseen(answered, "drives.write_acknowledged", "drives.write_unknown", **said)
    raw: int | None = None
    error: DrivebusError | None = None
    for attempt in range(BACK_TRIES):
        if attempt:
            yield from wait(BACK_PAUSE_S)
        try:
            raw, error = (yield from _fenced_raw(talk, wanted.parameter)), None
        except PreflightError as silent:
            error = silent
        if raw == wanted.raw and error is None:
            return talk.outcome(OutcomeWord.CONFIRMED, "drives.write_confirmed", **said)
    if error is not None or raw is None:
        return talk.outcome(OutcomeWord.UNKNOWN, "drives.write_unknown", **said)
    found = talk.dialect.parameter_reading(wanted.parameter, raw, None).value
    return talk.outcome(OutcomeWord.FAILED, "drives.write_differs", found=found, **said)


def _fenced_raw(talk: Talk, parameter: Parameter) -> Conversation[int | None]:
    request = talk.dialect.read_parameter(parameter)
    if not talk.dialect.clashes(request):
        yield from talk.fence(avoid=request)
    return (yield from read_raw(talk, parameter))
