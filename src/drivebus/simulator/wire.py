"""A wire between hosts and stations: character times, collisions, noise, echo, delay. Pure: ``now`` is an argument.

What is said becomes a ``Transmission``; the wire says when which part of it reaches whom (``pop``). Two that overlap
in time garble each other: of the earlier one the overlapped characters are wrong, of the later one they are swallowed.
"""

from __future__ import annotations

from enum import Enum
from heapq import heappop, heappush
from math import ceil

from drivebus.clock import Rng
from drivebus.serial_settings import SerialSettings
from drivebus.simulator.line_quality import LineQuality

_EPSILON_S = 1e-9
_PAUSE_CHARACTERS = 5.0
"""Silence that a station keeps between two frames of its own."""


class Side(Enum):
    """Who listens."""

    MASTERS = "hosts"
    STATIONS = "stations"


class Transmission:
    """Characters of one talker, one after another without a pause."""

    __slots__ = ("character_s", "data", "dropped", "end", "marked", "quiet_s", "start", "talker")

    def __init__(self, talker: object, data: bytes, start: float, character_s: float, quiet_s: float) -> None:
        self.talker = talker
        self.data: bytes | bytearray = data
        self.start = start
        self.character_s = character_s
        self.end = start + len(data) * character_s
        self.quiet_s = quiet_s
        """Silence on the wire before it."""
        self.marked: set[int] = set()
        """Characters with a parity or framing error."""
        self.dropped: set[int] = set()

    def received(self, first: int = 0, last: int | None = None) -> tuple[bytes, int]:
        """The characters first…last-1 as a receiver gets them, and how many of them are marked."""
        last = len(self.data) if last is None else last
        if not self.dropped and not self.marked:
            return bytes(self.data[first:last]), 0
        kept = [index for index in range(first, last) if index not in self.dropped]
        return bytes(self.data[index] for index in kept), sum(index in self.marked for index in kept)

    def corrupt(self, index: int, byte: int, marked: bool) -> None:
        """Make one character another one."""
        if isinstance(self.data, bytes):
            self.data = bytearray(self.data)
        self.data[index] = byte
        if marked:
            self.marked.add(index)

    def overlapped(self, other: Transmission) -> range:
        """The characters of this one that are on the wire together with some of ``other``."""
        size = len(self.data)
        first = int(max(0.0, (other.start - self.start) / self.character_s + _EPSILON_S))
        last = ceil(min(size, (other.end - self.start) / self.character_s - _EPSILON_S))
        return range(first, max(first, last))


class Wire:
    """One pair of copper with its noise. ``settings`` are those of the stations."""

    def __init__(self, settings: SerialSettings, weather: LineQuality, rng: Rng) -> None:
        self.settings = settings
        self.line_quality = weather
        self.station_delays: tuple[float, ...] = (0.0,)
        """How long after a transmission stations look at it: RTU 3.5 characters, 0 where length decides."""
        self.plugged = True
        """False: nothing passes between hosts and stations."""
        self.collisions = 0
        self.busy_s = 0.0
        """Seconds with somebody talking."""
        self._rng = rng
        self._recent: list[Transmission] = []
        self._last_end = float("-inf")
        self._events: list[tuple[float, int, Side, Transmission, int, int]] = []
        self._event_number = 0

    def transmit(
        self,
        source: object,
        data: bytes,
        now: float,
        sides: tuple[Side, ...],
        settings: SerialSettings | None = None,
        at: float | None = None,
    ) -> Transmission:
        """``talker`` starts to send at ``at`` (default ``now``), or when its earlier bytes have left.

        ``settings`` other than the wire's own (a wrong baud rate) make all of it unreadable.
        """
        self._drop_ended(now)
        start = now if at is None else at
        for recent in self._recent:
            if recent.talker is source and recent.end > start:
                start = recent.end
        said = Transmission(source, data, start, (settings or self.settings).character_s, self._silence_before(start))
        self._impair(said, foreign=settings is not None and settings != self.settings)
        self._collide(said)
        self._recent.append(said)
        self.busy_s += said.end - said.start
        if self.plugged and not self._chance(self.line_quality.loss):
            self._schedule(said, sides)
        return said

    def transmit_reply(self, source: object, data: bytes, now: float, at: float) -> Transmission:
        """A station answers the hosts at ``at``, subject to lateness, stray bytes and duplication.

        However late, a station answers in order.
        """
        weather = self.line_quality
        late = at + (self._rng.random() * weather.late_s if self._chance(weather.late) else 0.0)
        if self._chance(weather.junk):
            data = bytes((self._rng.randrange(0, 256),)) + data
        pause = self.settings.seconds(_PAUSE_CHARACTERS)
        at = max((recent.end + pause for recent in self._recent if recent.talker is source), default=at)
        said = self.transmit(source, data, now, (Side.MASTERS,), at=max(at, late))
        if self._chance(weather.duplicate):
            self.transmit(source, data, now, (Side.MASTERS,), at=said.end + pause)
        return said

    def silent_since(self, now: float) -> float:
        """When the last bit that began before ``now`` ended (or will end)."""
        return max((recent.end for recent in self._recent if recent.start < now - _EPSILON_S), default=self._last_end)

    def next_event_at(self) -> float | None:
        """When ``pop`` will have something."""
        return self._events[0][0] if self._events else None

    def pop_event(self, now: float) -> tuple[Side, Transmission, int, int] | None:
        """The next part that has reached somebody by ``now``: who, of what, characters first…last-1.

        For stations ``last`` is the place in ``waits`` of those whose turn it is.
        """
        if not self._events or self._events[0][0] > now + _EPSILON_S:
            return None
        _, _, side, said, first, last = heappop(self._events)
        return side, said, first, last

    def discard_pending(self) -> None:
        """Everything on its way is lost."""
        self._events.clear()
        self._recent.clear()

    def _silence_before(self, start: float) -> float:
        return start - self.silent_since(start)

    def _chance(self, share: float) -> bool:
        return share > 0.0 and self._rng.random() < share

    def _impair(self, said: Transmission, foreign: bool) -> None:
        weather, rng, size = self.line_quality, self._rng, len(said.data)
        if foreign:
            for index in range(size):
                said.corrupt(index, rng.randrange(0, 256), True)
        if weather.flip > 0.0:
            for index in range(size):
                if rng.random() < weather.flip:
                    said.corrupt(index, said.data[index] ^ 1 << rng.randrange(0, 8), self.settings.parity != "N")
        if size and self._chance(weather.cut_first):
            said.dropped.add(0)
        if size and self._chance(weather.cut_last):
            said.dropped.add(size - 1)

    def _collide(self, said: Transmission) -> None:
        for other in self._recent:
            if other.talker is said.talker or other.end <= said.start or said.end <= other.start:
                continue
            self.collisions += 1
            earlier, later = (other, said) if other.start <= said.start else (said, other)
            for index in earlier.overlapped(later):
                self._corrupt_overlap(earlier, index)
            later.dropped.update(later.overlapped(earlier))

    def _corrupt_overlap(self, said: Transmission, index: int) -> None:
        """Two drivers on one pair: any byte may come of it; a parity bit notices every other time."""
        said.corrupt(index, self._rng.randrange(0, 256), self.settings.parity != "N" and self._rng.random() < 0.5)

    def _drop_ended(self, now: float) -> None:
        """What has ended can't collide any more; only its end is remembered."""
        for old in self._recent:
            if old.end <= now:
                self._last_end = max(self._last_end, old.end)
        self._recent = [recent for recent in self._recent if recent.end > now]

    def _schedule(self, said: Transmission, sides: tuple[Side, ...]) -> None:
        size = len(said.data)
        if Side.STATIONS in sides:
            for place, wait in enumerate(self.station_delays):
                self._push(said.end + wait, Side.STATIONS, said, 0, place)
        if Side.MASTERS not in sides:
            return
        if not self.line_quality.per_byte and not self.line_quality.batch_s:
            self._push(said.end, Side.MASTERS, said, 0, size)
            return
        first = 0
        for index in range(size):
            at = self._delivery_time(said, index)
            if index + 1 == size or self._delivery_time(said, index + 1) > at:
                self._push(at, Side.MASTERS, said, first, index + 1)
                first = index + 1

    def _delivery_time(self, said: Transmission, index: int) -> float:
        at = said.start + (index + 1) * said.character_s
        grid = self.line_quality.batch_s
        return ceil(at / grid - _EPSILON_S) * grid if grid else at

    def _push(self, at: float, side: Side, said: Transmission, first: int, last: int) -> None:
        self._event_number += 1
        heappush(self._events, (at, self._event_number, side, said, first, last))
