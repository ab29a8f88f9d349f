"""Groups, interlocks and alarms: what they name exists, and what they ask for can happen."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from drivebus.profiles.diagnostics import Issue, KeyPath, issue
from drivebus.service.config import check_alarms, check_interlocks
from drivebus.service.config.check_drives import suggestions
from drivebus.service.config.parsed import ParsedPlant
from drivebus.service.config.schema import GroupTable


def rule_problems(draft: ParsedPlant) -> Iterator[Issue]:
    for id, group in draft.file.group.items():
        yield from check_drive_names(draft, group.drives, ("group", id, "drives"))
        yield from _check_group(id, group)
    for id, interlock in draft.file.interlock.items():
        yield from check_drive_names(draft, interlock.drives, ("interlock", id, "drives"))
    for id, alarm in draft.file.alarm.items():
        yield from check_drive_names(draft, alarm.drives, ("alarm", id, "drives"))
    yield from check_interlocks.interlock_problems(draft)
    yield from check_alarms.alarm_problems(draft)


def check_drive_names(draft: ParsedPlant, drives: Sequence[str], path: KeyPath) -> Iterator[Issue]:
    """A list of drives: each exists, none stands twice."""
    known = draft.known_ids("drive")
    for index, drive in enumerate(drives):
        if drive not in known:
            yield issue("unknown_drive", path, drive, **suggestions(drive, known))
        elif drive in drives[:index]:
            yield issue("drive_twice", path, drive)


def _check_group(id: str, group: GroupTable) -> Iterator[Issue]:
    path = ("group", id)
    if group.leader is not None and group.leader not in group.drives:
        yield issue("not_in_group", (*path, "leader"), group.leader, drives=", ".join(group.drives))
    if group.ratios and group.leader is None:
        yield issue("no_leader", (*path, "ratios"), ", ".join(group.ratios))
    for drive in group.ratios:
        if drive not in group.drives:
            yield issue("not_in_group", (*path, "ratios", drive), drive, drives=", ".join(group.drives))
        elif drive == group.leader:
            yield issue("ratio_of_leader", (*path, "ratios", drive), drive)
