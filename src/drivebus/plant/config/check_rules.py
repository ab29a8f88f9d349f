"""Groups, interlocks and alarms: what they name exists, and what they ask for can happen."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from drivebus.plant.config import check_alarms, check_interlocks
from drivebus.plant.config.check_drives import near
from drivebus.plant.config.draft import Draft
from drivebus.plant.config.schema import GroupTable
from drivebus.profiles.complaint import Path, Problem, problem


def problems(draft: Draft) -> Iterator[Problem]:
    for id, group in draft.file.group.items():
        yield from named(draft, group.drives, ("group", id, "drives"))
        yield from _group(id, group)
    for id, interlock in draft.file.interlock.items():
        yield from named(draft, interlock.drives, ("interlock", id, "drives"))
    for id, alarm in draft.file.alarm.items():
        yield from named(draft, alarm.drives, ("alarm", id, "drives"))
    yield from check_interlocks.problems(draft)
    yield from check_alarms.problems(draft)


def named(draft: Draft, drives: Sequence[str], path: Path) -> Iterator[Problem]:
    """A list of drives: each exists, none stands twice."""
    known = draft.known("drive")
    for index, drive in enumerate(drives):
        if drive not in known:
            yield problem("unknown_drive", path, drive, **near(drive, known))
        elif drive in drives[:index]:
            yield problem("drive_twice", path, drive)


def _group(id: str, group: GroupTable) -> Iterator[Problem]:
    path = ("group", id)
    if group.leader is not None and group.leader not in group.drives:
        yield problem("not_in_group", (*path, "leader"), group.leader, drives=", ".join(group.drives))
    if group.ratios and group.leader is None:
        yield problem("no_leader", (*path, "ratios"), ", ".join(group.ratios))
    for drive in group.ratios:
        if drive not in group.drives:
            yield problem("not_in_group", (*path, "ratios", drive), drive, drives=", ".join(group.drives))
        elif drive == group.leader:
            yield problem("ratio_of_leader", (*path, "ratios", drive), drive)
