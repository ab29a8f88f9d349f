"""Wire between masters and stations: character times, collisions, noise, echo, delay.

A transmission reaches its receivers in parts, which ``pop_event`` returns with the time as an argument. Of two that
overlap, the earlier one has wrong characters and the later one loses them.
"""

from __future__ import annotations

from enum import Enum
from heapq import heappop, heappush
from itertools import count
from math import ceil

from drivebus.clock import Rng
from drivebus.serial_settings import SerialSettings
from drivebus.simulator.line_quality import LineQuality

EPSILON_S = 1e-9  # times of the wire that differ by less are equal
_PAUSE_CHARACTERS = 5.0
"""Silence of a station between two frames of its own, in characters."""


class Side(Enum):
    """Receivers of a transmission."""

    MASTERS = "masters"
    STATIONS = "stations"


MASTERS, STATIONS = Side  # reading a member from its class takes four times as long
TO_MASTERS = (MASTERS,)
TO_STATIONS = (STATIONS,)
TO_ALL = (STATIONS, MASTERS)


class Transmission:
    """Characters of one source, without a pause between them."""

    __slots__ = ("character_s", "data", "dropped", "end", "marked", "silence_s", "source", "start")

    def __init__(self, source: object, data: bytes, start: float, character_s: float, silence_s: float) -> None:
        self.source = source
        self.data: bytes | bytearray = data
        self.start = start
        self.character_s = character_s
        self.end = start + len(data) * character_s
        self.silence_s = silence_s
        """Silence on the wire before it, in seconds."""
        self.marked: set[int] = set()
        """Characters with a parity or framing error."""
        self.dropped: set[int] = set()
        """Characters that are lost."""

    def received(self, first: int = 0, last: int | None = None) -> tuple[bytes, int]:
        """Return the characters first…last-1 as received, and the number of line errors among them."""
        if not self.dropped and not self.marked:
            return bytes(self.data[first:last]), 0
        last = len(self.data) if last is None else last
        indices = [index for index in range(first, last) if index not in self.dropped]
        return bytes(self.data[index] for index in indices), sum(index in self.marked for index in indices)

    def corrupt(self, index: int, byte: int, *, marked: bool) -> None:
        """Replace one character, with a line error where ``marked``."""
        if isinstance(self.data, bytes):
            self.data = bytearray(self.data)
        self.data[index] = byte
        if marked:
            self.marked.add(index)

    def overlapped(self, other: Transmission) -> range:
        """Return the characters that overlap with ``other``."""
        size = len(self.data)
        first = int(max(0.0, (other.start - self.start) / self.character_s + EPSILON_S))
        last = ceil(min(size, (other.end - self.start) / self.character_s - EPSILON_S))
        return range(first, max(first, last))


WireEvent = tuple[float, int, Side, Transmission, int, int, float]
"""Part of a transmission that is received at one time: that time, the order of events of the same time, the receivers,
the transmission, its first character received now, the one after its last, and the delay from the last bit after which
the event of a station is due. A named tuple takes four times as long to make."""


class Wire:
    """Pair of wires with its noise. ``settings`` are those of the stations."""

    def __init__(self, settings: SerialSettings, quality: LineQuality, rng: Rng) -> None:
        self.settings = settings
        self._character_s = settings.character_s
        self._pause_s = settings.seconds(_PAUSE_CHARACTERS)
        self.line_quality = quality
        self.station_delays: tuple[float, ...] = (0.0,)
        """Delays after which stations decide on a frame: RTU 3.5 characters, 0 where its length decides."""
        self.plugged = True
        """False: nothing passes between masters and stations."""
        self.collisions = 0
        self.busy_s = 0.0
        """Seconds with a transmission on the wire."""
        self._rng = rng
        self._recent: list[Transmission] = []
        self._last_end = float("-inf")
        self._events: list[WireEvent] = []
        self._event_numbers = count()

    def transmit(
        self,
        source: object,
        data: bytes,
        now: float,
        sides: tuple[Side, ...],
        settings: SerialSettings | None = None,
        at: float | None = None,
    ) -> Transmission:
        """Transmit from ``at`` (default ``now``), or after the earlier bytes of the same source.

        ``settings`` other than the wire's own (a wrong baud rate) make all of it unreadable.
        """
        self._drop_ended(now)
        start = now if at is None else at
        silent_since = self._last_end
        if self._recent:
            for recent in self._recent:
                if recent.source is source and recent.end > start:
                    start = recent.end
            silent_since = self.silent_since(start)
        foreign = self.is_foreign(settings)
        character_s = settings.character_s if foreign and settings is not None else self._character_s
        transmission = Transmission(source, data, start, character_s, start - silent_since)
        quality = self.line_quality
        if foreign or quality.flip or quality.cut_first or quality.cut_last:
            self._impair(transmission, foreign=foreign)
        if self._recent:
            self._collide(transmission)
        self._recent.append(transmission)
        self.busy_s += transmission.end - transmission.start
        if self.plugged and not (quality.loss and self._chance(quality.loss)):
            self._schedule(transmission, sides)
        return transmission

    def is_foreign(self, settings: SerialSettings | None) -> bool:
        """Return whether these serial settings of a master differ from those of the stations."""
        return settings is not None and settings is not self.settings and settings != self.settings

    def transmit_reply(self, source: object, data: bytes, now: float, at: float) -> Transmission:
        """Transmit a reply at ``at``, subject to lateness, stray bytes and duplication; replies keep their order."""
        quality = self.line_quality
        if quality.late and self._chance(quality.late):
            at += self._rng.random() * quality.late_s
        if quality.junk and self._chance(quality.junk):
            data = bytes((self._rng.randrange(0, 256),)) + data
        for recent in self._recent:
            if recent.source is source and recent.end + self._pause_s > at:
                at = recent.end + self._pause_s
        transmission = self.transmit(source, data, now, TO_MASTERS, at=at)
        if quality.duplicate and self._chance(quality.duplicate):
            self.transmit(source, data, now, TO_MASTERS, at=transmission.end + self._pause_s)
        return transmission

    def silent_since(self, now: float) -> float:
        """Return the time at which the last bit that began before ``now`` ends."""
        end: float | None = None
        for recent in self._recent:
            if recent.start < now - EPSILON_S and (end is None or recent.end > end):
                end = recent.end
        return self._last_end if end is None else end

    def next_event_at(self) -> float | None:
        """Return the time of the next event."""
        return self._events[0][0] if self._events else None

    def pop_event(self, now: float) -> WireEvent | None:
        """Return the next part that is received by ``now``."""
        if not self._events or self._events[0][0] > now + EPSILON_S:
            return None
        return heappop(self._events)

    def discard_pending(self) -> None:
        """Discard everything on its way."""
        self._events.clear()
        self._recent.clear()

    def _chance(self, share: float) -> bool:
        """Return whether an impairment of this probability happens; without one (0) no random number is drawn."""
        return share > 0.0 and self._rng.random() < share

    def _impair(self, transmission: Transmission, *, foreign: bool) -> None:
        quality, rng, size = self.line_quality, self._rng, len(transmission.data)
        if foreign:
            for index in range(size):
                transmission.corrupt(index, rng.randrange(0, 256), marked=True)
        if quality.flip > 0.0:
            for index in range(size):
                if rng.random() < quality.flip:
                    transmission.corrupt(
                        index, transmission.data[index] ^ 1 << rng.randrange(0, 8), marked=self.settings.parity != "N"
                    )
        if size and self._chance(quality.cut_first):
            transmission.dropped.add(0)
        if size and self._chance(quality.cut_last):
            transmission.dropped.add(size - 1)

    def _collide(self, transmission: Transmission) -> None:
        for other in self._recent:
            if (
                other.source is transmission.source
                or other.end <= transmission.start
                or transmission.end <= other.start
            ):
                continue
            self.collisions += 1
            earlier, later = (other, transmission) if other.start <= transmission.start else (transmission, other)
            for index in earlier.overlapped(later):
                self._corrupt_overlap(earlier, index)
            later.dropped.update(later.overlapped(earlier))

    def _corrupt_overlap(self, transmission: Transmission, index: int) -> None:
        """Corrupt an overlapped character; a parity bit detects every other one."""
        transmission.corrupt(
            index, self._rng.randrange(0, 256), marked=self.settings.parity != "N" and self._rng.random() < 0.5
        )

    def _drop_ended(self, now: float) -> None:
        """Drop ended transmissions, which can't collide any more."""
        going_on = []
        for recent in self._recent:
            if recent.end > now:
                going_on.append(recent)
            elif recent.end > self._last_end:
                self._last_end = recent.end
        self._recent = going_on

    def _schedule(self, transmission: Transmission, sides: tuple[Side, ...]) -> None:
        size = len(transmission.data)
        if STATIONS in sides:
            for delay_s in self.station_delays:
                self._push(transmission.end + delay_s, STATIONS, transmission, 0, size, delay_s)
        if MASTERS not in sides:
            return
        if not self.line_quality.per_byte and not self.line_quality.batch_s:
            self._push(transmission.end, MASTERS, transmission, 0, size)
            return
        first = 0
        for index in range(size):
            at = self._delivery_time(transmission, index)
            if index + 1 == size or self._delivery_time(transmission, index + 1) > at:
                self._push(at, MASTERS, transmission, first, index + 1)
                first = index + 1

    def _delivery_time(self, transmission: Transmission, index: int) -> float:
        at = transmission.start + (index + 1) * transmission.character_s
        grid = self.line_quality.batch_s
        return ceil(at / grid - EPSILON_S) * grid if grid else at

    def _push(
        self, at: float, side: Side, transmission: Transmission, first: int, last: int, decision_delay_s: float = 0.0
    ) -> None:
        number = next(self._event_numbers)
        heappush(self._events, (at, number, side, transmission, first, last, decision_delay_s))
