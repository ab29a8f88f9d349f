"""A line and all that is on it: one setting that everybody can have, one family, and polls that it can carry."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from drivebus.bus.mixed import kind_of
from drivebus.bus.planner import Poll, arithmetic
from drivebus.drives.dialect import Dialect
from drivebus.line import LineSettings
from drivebus.plant.config import build
from drivebus.plant.config.draft import Draft
from drivebus.plant.config.polling import FULL_PERCENT, PACES_S, cost, line_of
from drivebus.plant.config.schema import DriveTable
from drivebus.plant.model import DriveSetting
from drivebus.profiles.complaint import Problem, problem
from drivebus.profiles.model import DriveProfile

Where = tuple[str | int, ...]


def problems(draft: Draft) -> Iterator[Problem]:
    for bus in draft.file.bus:
        drives = [(id, one) for id, one in draft.on(bus) if id in draft.profiles]
        faults = list(_mixed(draft, drives)) or list(_settings(draft, bus, drives))
        yield from faults
        clear = bus in draft.links and not faults
        if clear and drives and all(id in draft.dialects for id, _ in drives):
            yield from _costs(draft, bus, drives)


def _mixed(draft: Draft, drives: list[tuple[str, DriveTable]]) -> Iterator[Problem]:
    """T18: bytes of one protocol may look like a frame of another."""
    spoken = [(id, draft.dialects[id]) for id, _ in drives if id in draft.dialects]
    for id, dialect in spoken[1:]:
        first, other = spoken[0]
        if kind_of(dialect.codec) != kind_of(other.codec):
            found, expected = ("/".join(kind_of(one.codec)) for one in (dialect, other))
            yield problem("mixed", ("drive", id, "bus"), found, other=first, expected=expected)


def _settings(draft: Draft, bus: str, drives: list[tuple[str, DriveTable]]) -> Iterator[Problem]:
    """The line's baud rate and format: known, and offered by every model on it."""
    link = draft.links.get(bus)
    if link is None:
        return
    for name in ("baud", "format"):
        path = _path(draft, bus, name)
        if name in link.given:
            value = getattr(link.settings, name)
            yield from _not_offered(draft, drives, name, value, path)
        else:
            factory = {getattr(draft.profiles[id].line, name) for id, _ in drives}
            if len(factory) > 1:
                values = ", ".join(str(one) for one in sorted(factory))
                yield problem("line_unclear", path, "-", name=name, values=values)


def _path(draft: Draft, bus: str, name: str) -> Where:
    """Where the value stands: a key of its own, else in the LINK."""
    own = getattr(draft.file.bus[bus], name) is not None
    return ("bus", bus, name) if own else ("bus", bus, "link")


def _not_offered(
    draft: Draft, drives: list[tuple[str, DriveTable]], name: str, value: int | str, path: Where
) -> Iterator[Problem]:
    for id, _ in drives:
        offered = _offered(draft.profiles[id], name)
        if value not in offered:
            choices = ", ".join(str(one) for one in offered)
            yield problem("line_not_offered", path, value, drive=id, model=draft.profiles[id].model, choices=choices)
            return


def _offered(profile: DriveProfile, name: str) -> tuple[int | str, ...]:
    return profile.line.bauds if name == "baud" else profile.line.formats


def _costs(draft: Draft, bus: str, drives: list[tuple[str, DriveTable]]) -> Iterator[Problem]:
    setting = build.bus(draft.file, bus)
    line = line_of(setting, draft.profiles[drives[0][0]])
    found = list(_too_often(draft, drives, line))
    yield from found
    paced = [(one, draft.dialects[one.id]) for one in build.on_bus(draft, setting)]
    load = cost(paced, line).load_percent
    if load > FULL_PERCENT and not found:
        least = pace_for(paced, line)
        yield problem("overload", ("bus", bus), f"{load:.0f} %", line=str(line), drives=len(paced), least=least)


def _too_often(draft: Draft, drives: list[tuple[str, DriveTable]], line: LineSettings) -> Iterator[Problem]:
    """One question and its answer take longer than the period that was asked for."""
    for id, drive in drives:
        for name, period_s in drive.signals.items():
            least_s = _once_s(draft.dialects[id], name, line)
            if name in draft.profiles[id].signals and max(period_s, drive.fastest_s or 0.0) < least_s:
                path = ("drive", id, "signals", name)
                yield problem("too_often", path, f"{period_s:g} s", least=f"{least_s:.3f}", line=str(line))


def _once_s(dialect: Dialect, name: str, line: LineSettings) -> float:
    """The longest that one of the questions for this signal may take."""
    polls = [Poll(request, 1.0) for request, _ in dialect.polls((name,))]
    return max((arithmetic([(dialect.link, [poll])], line).cycle_s for poll in polls), default=0.0)


def pace_for(drives: list[tuple[DriveSetting, Dialect]], line: LineSettings) -> str:
    """The ``fastest_s`` with which the line could carry all these drives."""
    for pace_s in PACES_S:
        paced = [(replace(drive, fastest_s=max(pace_s, drive.fastest_s)), dialect) for drive, dialect in drives]
        if cost(paced, line).load_percent <= FULL_PERCENT:
            return f"{pace_s:g}"
    return f"> {PACES_S[-1]:g}"
