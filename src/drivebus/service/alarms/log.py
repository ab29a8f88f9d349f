"""The history of alarms: one line for each change in an append-only file, the newest alarms in memory.

A line is the whole alarm as it then was: the last line of an alarm tells all, and a torn line spoils only itself.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from drivebus.service.alarms.model import Alarm
from drivebus.service.api.paging import page
from drivebus.service.live.views import Json
from drivebus.service.storage.append_log import AppendLog, write_durably
from drivebus.service.storage.batch_writer import BatchWriter

KEPT = 5_000
"""Alarms that the history keeps; older ones are forgotten (I12)."""
LINES = 4 * KEPT
"""A file with more lines is written anew, with one line for each alarm."""


class AlarmLog:
    """``load`` once, then ``put`` for each change; kept within milliseconds, or as soon as the disk works again."""

    def __init__(self, path: Path) -> None:
        self._journal = AppendLog(path)
        self._alarms: dict[str, Alarm] = {}
        self._lines = 0
        self._writer: BatchWriter[Alarm, None] = BatchWriter("alarms", self._append_batch)

    @property
    def error(self) -> Exception | None:
        """Why the last changes are in memory only; None: they are kept."""
        return self._writer.error

    @property
    def next_number(self) -> int:
        """The number of the next new alarm."""
        return 1 + max((alarm_number(id) for id in self._alarms), default=0)

    def load(self) -> list[Alarm]:
        """What was still active. A history that can't be read is as good as none: control does not depend on it."""
        try:
            data = self._journal.path.read_bytes()
        except OSError:
            data = b""
        for alarm in _decode_lines(data.split(b"\n")):
            self._remember(alarm)
        self._lines = data.count(b"\n") + (LINES if data and not data.endswith(b"\n") else 0)  # torn: write it anew
        return [alarm for alarm in self._alarms.values() if alarm.active]

    def put(self, alarm: Alarm) -> None:
        """From within the loop; waits for nothing."""
        self._remember(alarm)
        self._writer.write_nowait(alarm)

    async def close(self) -> None:
        await self._writer.close()
        self._journal.close()

    def retry(self) -> None:
        """A disk that failed may work again."""
        self._writer.retry()

    def history(
        self, from_ms: int, to_ms: int, drive: str | None = None, cursor: str | None = None, limit: int = 100
    ) -> Json:
        """Alarms raised from ``from_ms`` up to and without ``to_ms``, newest first.

        Raises InvalidParameters for an unknown cursor.
        """
        found = sorted(self._alarms.values(), key=lambda one: -alarm_number(one.id))
        wanted = (a for a in found if from_ms <= a.raised_ms < to_ms and drive in (None, a.drive))
        return page(((alarm_number(alarm.id), alarm.as_json) for alarm in wanted), cursor, limit)

    def _remember(self, alarm: Alarm) -> None:
        self._alarms[alarm.id] = alarm
        if len(self._alarms) > KEPT:
            del self._alarms[next(id for id in self._alarms)]

    def _append_batch(self, alarms: Sequence[Alarm]) -> list[None]:
        """In the thread."""
        if self._lines + len(alarms) > LINES:
            self._journal.close()
            write_durably(self._journal.path, _encode_lines([*self._alarms.values()]))
            self._lines = len(self._alarms)
        self._journal.append(_encode_lines(alarms))
        self._lines += len(alarms)
        return [None] * len(alarms)


def alarm_number(id: str) -> int:
    """Of an alarm's id; later alarms have larger ones."""
    return int(id[1:])


def _encode_lines(alarms: Iterable[Alarm]) -> bytes:
    return b"".join(json.dumps(alarm.as_json(), separators=(",", ":")).encode() + b"\n" for alarm in alarms)


def _decode_lines(lines: Iterable[bytes]) -> Iterator[Alarm]:
    """What can be read; a torn or spoilt line is left out."""
    for line in lines:
        try:
            alarm = Alarm.from_json(json.loads(line))
            alarm_number(alarm.id)
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
            continue
        yield alarm
