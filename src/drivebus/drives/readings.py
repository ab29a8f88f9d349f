"""Newest two readings of every value: a decision needs two that agree."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from drivebus.values import Quality, Reading

Readings = Mapping[str, Reading]
"""Readings of one reply by signal name; "state", "fault" and "command" carry raw words."""


class ReadingPairs:
    """Newest reading of every value and the one before it: two equal reads square the error rate."""

    def __init__(self) -> None:
        self.latest: dict[str, Reading] = {}
        self.previous: dict[str, Reading] = {}

    def add(self, readings: Readings) -> None:
        """Add the readings of one reply."""
        for name, reading in readings.items():
            if name in self.latest:
                self.previous[name] = self.latest[name]
            self.latest[name] = reading

    def pair(self, name: str) -> tuple[Reading, Reading] | None:
        """Return the last two readings, older first; None unless both exist and neither is bad."""
        older, newer = self.previous.get(name), self.latest.get(name)
        if older is None or newer is None or Quality.BAD in (older.quality, newer.quality):
            return None
        return older, newer

    def raw_pair(self, name: str) -> tuple[int, int] | None:
        """Return the raw words of the last two readings, older first."""
        pair = self.pair(name)
        if pair is None or pair[0].raw is None or pair[1].raw is None:
            return None
        return pair[0].raw, pair[1].raw

    def agreed_raw(self, name: str) -> int | None:
        """Return the raw word on which the last two readings agree, else None."""
        pair = self.raw_pair(name)
        return pair[0] if pair is not None and pair[0] == pair[1] else None

    def oldest_time(self, *names: str) -> float | None:
        """Return the time of the oldest of these newest readings; None where one is missing."""
        times = [self.latest[name].source_time if name in self.latest else None for name in names]
        known = [time for time in times if time is not None]
        return min(known) if known and len(known) == len(times) else None

    def is_since(self, name: str, other: str) -> bool:
        """Return whether the newest reading of a value is no older than the last but one of another."""
        newest, first = self.latest[name].source_time, self.previous[other].source_time
        return newest is not None and first is not None and newest >= first

    def bad_reason(self, *names: str) -> str | None:
        """Return why the first of these newest readings that is bad can't be used, None where none is bad."""
        bad = [self.latest[name] for name in names if name in self.latest and self.latest[name].quality is Quality.BAD]
        return bad[0].reason if bad else None

    def clear(self, *names: str) -> None:
        """Remove readings that are older than a command: they can't show its effect."""
        for name in names or (*self.latest, *self.previous):
            self.latest.pop(name, None)
            self.previous.pop(name, None)

    def with_staleness(
        self, now: float, max_age_s: Mapping[str, float], port_opened_at: float | None
    ) -> dict[str, Reading]:
        """Return the newest readings, bad where too old or not read since the port was opened; the value stays.

        ``max_age_s``: name → age limit in seconds. ``port_opened_at``: None while the port is not open.
        """
        return {
            name: _mark_stale(reading, now, max_age_s.get(name), port_opened_at)
            for name, reading in self.latest.items()
        }


def _mark_stale(reading: Reading, now: float, limit_s: float | None, port_opened_at: float | None) -> Reading:
    age = reading.age_s(now)
    if reading.source_time is not None and (port_opened_at is None or reading.source_time < port_opened_at):
        return replace(reading, quality=Quality.BAD, reason="drives.port_lost")
    if limit_s is None or age is None or age <= limit_s:
        return reading
    return replace(reading, quality=Quality.BAD, reason="drives.stale")
