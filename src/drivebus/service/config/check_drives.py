"""Drives, each for itself: its bus, model, address, settings, limits, signals; and no two at one address."""

from __future__ import annotations

from collections.abc import Iterator
from difflib import get_close_matches
from typing import Any

from drivebus.drives.dialects.create import create_dialect
from drivebus.profiles.diagnostics import Diagnostic, Issue, issue
from drivebus.profiles.model import DriveProfile
from drivebus.profiles.notation import nearest_names
from drivebus.service.config.build import polled_signals
from drivebus.service.config.parsed import ParsedPlant, is_model_path
from drivebus.service.config.polling import with_periods
from drivebus.service.config.schema import DriveTable


def drive_problems(draft: ParsedPlant) -> Iterator[Issue | Diagnostic]:
    taken: dict[tuple[str, int], str] = {}
    for id, drive in draft.file.drive.items():
        path = ("drive", id)
        if drive.bus not in draft.known_ids("bus"):
            yield issue("unknown_bus", (*path, "bus"), drive.bus, **suggestions(drive.bus, draft.known_ids("bus")))
        where = (drive.bus, drive.address)
        if where in taken:
            yield issue("same_address", (*path, "address"), drive.address, other=taken[where], bus=drive.bus)
        taken.setdefault(where, id)
        if id in draft.profile_errors:
            yield from _check_profile(draft, id, drive)
        elif id in draft.profiles:
            yield from _check_drive(draft, id, drive, draft.profiles[id])


def suggestions(name: str, known: list[str]) -> dict[str, Any]:
    """Places of a sentence about a name that nobody knows."""
    close = nearest_names(name, known) or get_close_matches(name, known, 1, 0.0)
    return {"known": ", ".join(known) or "-", "near": ", ".join(close) or "-"}


def _check_profile(draft: ParsedPlant, id: str, drive: DriveTable) -> Iterator[Issue | Diagnostic]:
    """Its profile: no such model, or the faults of its file."""
    found = draft.profile_errors[id].params
    path = ("drive", id, "model")
    kinds = [one.kind for one in found["complaints"]]
    if kinds == ["no_model"]:
        from drivebus import profiles

        yield issue("unknown_model", path, drive.model, **suggestions(drive.model, profiles.models()))
        return
    if kinds == ["no_file"] and is_model_path(drive.model):
        yield issue("no_file", path, draft.model_of(drive))
        return
    yield issue("refused_model", path, drive.model, count=len(kinds))
    first = next(one for one in draft.profile_errors if draft.profile_errors[one] is draft.profile_errors[id])
    yield from found["complaints"] if first == id else ()


def _check_drive(draft: ParsedPlant, id: str, drive: DriveTable, profile: DriveProfile) -> Iterator[Issue]:
    faults = [
        *_check_address(id, drive, profile),
        *_check_encoding(id, drive, profile),
        *_check_settings(id, drive, profile),
    ]
    yield from faults
    yield from _check_limits(id, drive, profile)
    yield from _check_signals(draft, id, drive, profile)
    if not faults:
        asked = with_periods(profile, drive.signals)
        draft.dialects[id] = create_dialect(asked, drive.address, encoding=drive.encoding, settings=drive.settings)


def _check_address(id: str, drive: DriveTable, profile: DriveProfile) -> Iterator[Issue]:
    low, high = profile.addresses
    path = ("drive", id, "address")
    if drive.address == profile.broadcast:
        yield issue("broadcast_address", path, drive.address, model=profile.model, low=low, high=high)
    elif not low <= drive.address <= high:
        yield issue("address", path, drive.address, model=profile.model, low=low, high=high)


def _check_encoding(id: str, drive: DriveTable, profile: DriveProfile) -> Iterator[Issue]:
    if drive.encoding is not None and drive.encoding not in profile.encodings:
        yield issue("choice", ("drive", id, "encoding"), drive.encoding, choices=", ".join(profile.encodings))


def _check_settings(id: str, drive: DriveTable, profile: DriveProfile) -> Iterator[Issue]:
    for name, value in drive.settings.items():
        path = ("drive", id, "settings", name)
        if name not in profile.settings:
            yield issue("unknown_setting", path, name, model=profile.model, **suggestions(name, list(profile.settings)))
        elif not _is_choice(profile, name, value):
            yield issue("choice", path, value, choices=_choices(profile, name))


def _is_choice(profile: DriveProfile, name: str, value: Any) -> bool:
    """This value is one that the open question can have."""
    question = next((one for one in profile.open_questions if one.setting == name), None)
    if question is None or not (question.choices or question.span):
        return type(value) is type(profile.settings[name])
    low, high = question.span or (1, 0)
    spanned = type(value) is int and low <= value <= high
    return spanned or any(type(value) is type(choice) and value == choice for choice in question.choices)


def _choices(profile: DriveProfile, name: str) -> str:
    question = next((one for one in profile.open_questions if one.setting == name), None)
    if question is None or not (question.choices or question.span):
        return type(profile.settings[name]).__name__
    span = [f"{question.span[0]} … {question.span[1]}"] if question.span else []
    shown = [str(one).lower() if isinstance(one, bool) else str(one) for one in question.choices]
    return ", ".join([*shown, *span])


def _check_limits(id: str, drive: DriveTable, profile: DriveProfile) -> Iterator[Issue]:
    """Nothing wider than the model's own: what a profile does not allow, its file must be changed for."""
    limits, own = drive.limits, profile.limits
    path = ("drive", id, "limits")
    highest = own.maximum_hz if limits.maximum_hz is None else limits.maximum_hz
    if highest > own.maximum_hz:
        yield issue("limit_wide", (*path, "maximum_hz"), highest, bound=f"<= {own.maximum_hz:g}", model=profile.model)
    if "minimum_hz" in limits.model_fields_set and limits.minimum_hz < own.minimum_hz:
        bound = f">= {own.minimum_hz:g}"
        yield issue("limit_wide", (*path, "minimum_hz"), limits.minimum_hz, bound=bound, model=profile.model)
    if limits.minimum_hz >= highest:
        yield issue("limits", (*path, "minimum_hz"), limits.minimum_hz, maximum=f"{highest:g}")
    if not (limits.forward or limits.reverse):
        yield issue("no_direction", (*path, "forward"), False)


def _check_signals(draft: ParsedPlant, id: str, drive: DriveTable, profile: DriveProfile) -> Iterator[Issue]:
    known = polled_signals(draft, id, drive.model_copy(update={"signals": {}}))
    for name in drive.signals:
        if name not in profile.signals:
            yield issue("unknown_signal", ("drive", id, "signals", name), name, drive=id, **suggestions(name, known))
