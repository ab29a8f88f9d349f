"""Alarm log: one line for each change of an alarm in an append-only file, the newest alarms also in memory.

A line holds the whole alarm, so that its last line is enough and a torn line affects nothing else.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from drivebus.atomic_write import atomic_write_private, link_or_copy
from drivebus.clock import wall_ms
from drivebus.regular_file import read_regular_file
from drivebus.service.alarms.model import Alarm
from drivebus.service.alarms.occurrences import AlarmOccurrences, alarm_number
from drivebus.service.api.paging import page
from drivebus.service.api.strict_json import parse_json
from drivebus.service.storage.append_log import AppendLog
from drivebus.service.storage.batch_writer import BatchWriter
from drivebus.types import Json

ALARM_LOG_FILE = "alarms.jsonl"
MAX_LOGGED_ALARMS = 5_000
"""Alarms kept in file and memory. Beyond it the oldest are dropped: first the inactive and the repeated ones."""
MAX_LOG_LINES = 4 * MAX_LOGGED_ALARMS
"""A file with more lines is rewritten with one line for each alarm."""


class AlarmLog:
    """Log file of alarms. Call ``load`` once, then ``put`` for each change; a failed write is retried."""

    def __init__(self, path: Path) -> None:
        self._journal = AppendLog(path)
        self._alarms: dict[str, Alarm] = {}
        self._occurrences = AlarmOccurrences()
        self._acknowledged: dict[str, Alarm] = {}
        """Id of a first occurrence → the repetition whose acknowledgement is that of all occurrences before it."""
        self._lines = 0
        self.damaged_copy = ""
        """Name of the copy of a file that could not be read in full at ``load``; empty if it could be read."""
        self._writer: BatchWriter[Alarm, None] = BatchWriter("alarms", self._append_batch)

    @property
    def error(self) -> Exception | None:
        """Error that keeps the last changes from the disk; None if all are written."""
        return self._writer.error

    @property
    def next_number(self) -> int:
        """Number of the next new alarm."""
        return 1 + max((alarm_number(id) for id in self._alarms), default=0)

    def load(self) -> list[Alarm]:
        """Read the file and return the alarms that are still active.

        An unreadable file counts as empty, because control of drives does not depend on it; it is put aside.
        """
        try:
            data = read_regular_file(self._journal.path)
        except FileNotFoundError:
            data = b""
        except OSError:
            data = b""
            self._put_aside(Path.rename)
        *lines, torn = data.split(b"\n")
        decoded = [_decode_line(line) for line in lines]
        for alarm in (*decoded, _decode_line(torn)):
            if alarm is not None:
                self._remember(alarm)
        if None in decoded:
            self._put_aside(link_or_copy)
        is_torn = torn or self.damaged_copy
        self._lines = data.count(b"\n") + (MAX_LOG_LINES if is_torn else 0)  # a torn end forces a rewrite
        return [alarm for alarm in map(self._with_acknowledgement, self._alarms.values()) if alarm.active]

    def _put_aside(self, move: Callable[[Path, Path], object]) -> None:
        """Give the file a second name, by which it can be repaired. Never raises."""
        copy = self._journal.path.with_name(f"{self._journal.path.name}.damaged-{wall_ms()}")
        with suppress(OSError):  # it stays as it is, and the next start tries again
            move(self._journal.path, copy)
            self.damaged_copy = copy.name

    def put(self, alarm: Alarm) -> None:
        """Queue a change. Never waits; call it on the event loop."""
        self._remember(alarm)
        self._writer.write_nowait(alarm)

    async def close(self) -> None:
        await self._writer.close()
        self._journal.close()

    def retry(self) -> None:
        """Try again to write after an error."""
        self._writer.retry()

    def history(
        self, *, from_ms: int, to_ms: int, drive: str | None = None, cursor: str | None = None, limit: int = 100
    ) -> Json:
        """Return a page of the alarms raised in ``from_ms <= time < to_ms``, newest first.

        Raises InvalidParameters for an unknown cursor.
        """
        newest_first = sorted(self._alarms.values(), key=lambda alarm: -alarm_number(alarm.id))
        matching = (a for a in newest_first if from_ms <= a.raised_ms < to_ms and drive in (None, a.drive))
        shown = map(self._with_acknowledgement, matching)
        return page(((alarm_number(alarm.id), alarm.as_json) for alarm in shown), cursor, limit)

    def _remember(self, alarm: Alarm) -> None:
        self._alarms[alarm.id] = alarm
        self._occurrences.add(alarm)
        if alarm.acknowledged_ms is not None and alarm.count > 1:
            self._acknowledged[alarm.first_id] = alarm
        if len(self._alarms) > MAX_LOGGED_ALARMS:
            alarms = self._alarms.values()
            self._drop(next((other for other in alarms if not self._is_listed(other)), next(iter(alarms))))

    def _is_listed(self, alarm: Alarm) -> bool:
        """Return whether an alarm is active and no repetition stands for it: the next start needs it."""
        return alarm.active and self._occurrences.newest_id(alarm.id) == alarm.id

    def _drop(self, alarm: Alarm) -> None:
        del self._alarms[alarm.id]
        self._occurrences.remove(alarm.id)
        if self._acknowledged.get(alarm.first_id) is alarm:
            del self._acknowledged[alarm.first_id]

    def _with_acknowledgement(self, alarm: Alarm) -> Alarm:
        """Return an alarm with the acknowledgement of its newest repetition, which is not written for each."""
        newest = self._acknowledged.get(alarm.first_id)
        if newest is None or alarm.acknowledged_ms is not None:
            return alarm
        return replace(alarm, acknowledged_ms=newest.acknowledged_ms, acknowledged_by=newest.acknowledged_by)

    def _append_batch(self, alarms: Sequence[Alarm]) -> list[None]:
        """Append changes on the writer's thread; rewrite the file when it has too many lines."""
        if self._lines + len(alarms) > MAX_LOG_LINES:
            self._journal.close()
            atomic_write_private(self._journal.path, _encode_lines([*self._alarms.values()]))
            self._lines = len(self._alarms)
        self._journal.append(_encode_lines(alarms))
        self._lines += len(alarms)
        return [None] * len(alarms)


def _encode_lines(alarms: Iterable[Alarm]) -> bytes:
    return b"".join(json.dumps(alarm.as_json(), separators=(",", ":")).encode() + b"\n" for alarm in alarms)


def _decode_line(line: bytes) -> Alarm | None:
    """Return the alarm of a line; None for a torn or damaged one."""
    try:
        alarm = Alarm.from_json(parse_json(line))
        alarm_number(alarm.id)
        alarm_number(alarm.first_id)
    except (ValueError, TypeError, KeyError, AttributeError):
        return None
    return alarm
