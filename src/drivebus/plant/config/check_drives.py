"""Drives, each for itself: its bus, model, address, settings, limits, signals; and no two at one address."""

from __future__ import annotations

from collections.abc import Iterator
from difflib import get_close_matches
from typing import Any

from drivebus.drives.make import make_dialect
from drivebus.plant.config.build import polled
from drivebus.plant.config.draft import Draft, is_path
from drivebus.plant.config.polling import with_periods
from drivebus.plant.config.schema import DriveTable
from drivebus.profiles.complaint import Complaint, Problem, problem
from drivebus.profiles.model import DriveProfile
from drivebus.profiles.notation import nearest


def problems(draft: Draft) -> Iterator[Problem | Complaint]:
    taken: dict[tuple[str, int], str] = {}
    for id, drive in draft.file.drive.items():
        path = ("drive", id)
        if drive.bus not in draft.known("bus"):
            yield problem("unknown_bus", (*path, "bus"), drive.bus, **near(drive.bus, draft.known("bus")))
        where = (drive.bus, drive.address)
        if where in taken:
            yield problem("same_address", (*path, "address"), drive.address, other=taken[where], bus=drive.bus)
        taken.setdefault(where, id)
        if id in draft.refused:
            yield from _refused(draft, id, drive)
        elif id in draft.profiles:
            yield from _fits(draft, id, drive, draft.profiles[id])


def near(name: str, known: list[str]) -> dict[str, Any]:
    """Places of a sentence about a name that nobody knows."""
    close = nearest(name, known) or get_close_matches(name, known, 1, 0.0)
    return {"known": ", ".join(known) or "-", "near": ", ".join(close) or "-"}


def _refused(draft: Draft, id: str, drive: DriveTable) -> Iterator[Problem | Complaint]:
    """Its profile: no such model, or the faults of its file."""
    found = draft.refused[id].params
    path = ("drive", id, "model")
    kinds = [one.kind for one in found["complaints"]]
    if kinds == ["no_model"]:
        from drivebus import profiles

        yield problem("unknown_model", path, drive.model, **near(drive.model, profiles.models()))
        return
    if kinds == ["no_file"] and is_path(drive.model):
        yield problem("no_file", path, draft.model(drive))
        return
    yield problem("refused_model", path, drive.model, count=len(kinds))
    first = next(one for one in draft.refused if draft.refused[one] is draft.refused[id])
    yield from found["complaints"] if first == id else ()


def _fits(draft: Draft, id: str, drive: DriveTable, profile: DriveProfile) -> Iterator[Problem]:
    faults = [*_address(id, drive, profile), *_encoding(id, drive, profile), *_settings(id, drive, profile)]
    yield from faults
    yield from _limits(id, drive, profile)
    yield from _signals(draft, id, drive, profile)
    if not faults:
        asked = with_periods(profile, drive.signals)
        draft.dialects[id] = make_dialect(asked, drive.address, encoding=drive.encoding, settings=drive.settings)


def _address(id: str, drive: DriveTable, profile: DriveProfile) -> Iterator[Problem]:
    low, high = profile.addresses
    path = ("drive", id, "address")
    if drive.address == profile.broadcast:
        yield problem("broadcast_address", path, drive.address, model=profile.model, low=low, high=high)
    elif not low <= drive.address <= high:
        yield problem("address", path, drive.address, model=profile.model, low=low, high=high)


def _encoding(id: str, drive: DriveTable, profile: DriveProfile) -> Iterator[Problem]:
    if drive.encoding is not None and drive.encoding not in profile.encodings:
        yield problem("choice", ("drive", id, "encoding"), drive.encoding, choices=", ".join(profile.encodings))


def _settings(id: str, drive: DriveTable, profile: DriveProfile) -> Iterator[Problem]:
    for name, value in drive.settings.items():
        path = ("drive", id, "settings", name)
        if name not in profile.settings:
            yield problem("unknown_setting", path, name, model=profile.model, **near(name, list(profile.settings)))
        elif not _answers(profile, name, value):
            yield problem("choice", path, value, choices=_choices(profile, name))


def _answers(profile: DriveProfile, name: str, value: Any) -> bool:
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


def _limits(id: str, drive: DriveTable, profile: DriveProfile) -> Iterator[Problem]:
    """Nothing wider than the model's own: what a profile does not allow, its file must be changed for."""
    limits, own = drive.limits, profile.limits
    path = ("drive", id, "limits")
    highest = own.maximum_hz if limits.maximum_hz is None else limits.maximum_hz
    if highest > own.maximum_hz:
        yield problem("limit_wide", (*path, "maximum_hz"), highest, bound=f"<= {own.maximum_hz:g}", model=profile.model)
    if "minimum_hz" in limits.model_fields_set and limits.minimum_hz < own.minimum_hz:
        bound = f">= {own.minimum_hz:g}"
        yield problem("limit_wide", (*path, "minimum_hz"), limits.minimum_hz, bound=bound, model=profile.model)
    if limits.minimum_hz >= highest:
        yield problem("limits", (*path, "minimum_hz"), limits.minimum_hz, maximum=f"{highest:g}")
    if not (limits.forward or limits.reverse):
        yield problem("no_direction", (*path, "forward"), False)


def _signals(draft: Draft, id: str, drive: DriveTable, profile: DriveProfile) -> Iterator[Problem]:
    known = polled(draft, id, drive.model_copy(update={"signals": {}}))
    for name in drive.signals:
        if name not in profile.signals:
            yield problem("unknown_signal", ("drive", id, "signals", name), name, drive=id, **near(name, known))
