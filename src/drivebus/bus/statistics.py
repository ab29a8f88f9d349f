"""Counting what happens on a bus, cheaply while it runs, and telling it when asked. Pure."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

from drivebus.errors import NoReply

RECENT = 512
"""So many reply times and transactions are remembered for the recent figures."""
WINDOW_S = 300.0
"""Error rates look back so far (RELIABILITY 4: link-quality gate)."""
SLICES = 10


class Counters:
    """What one station, or the whole bus, has seen."""

    __slots__ = (
        "bytes_received", "bytes_sent", "damage", "errors", "kinds", "recent", "replies", "transactions", "window",
    )  # fmt: skip

    def __init__(self) -> None:
        self.transactions = 0
        self.replies = 0
        self.bytes_sent = 0
        self.bytes_received = 0
        self.errors: dict[str, int] = {}
        self.kinds: dict[str, int] = {}
        self.recent: deque[float] = deque(maxlen=RECENT)
        self.window = ErrorWindow()
        self.damage = ErrorWindow()

    def kind(self, name: str, amount: int = 1) -> None:
        self.kinds[name] = self.kinds.get(name, 0) + amount

    def failed(self, error: Exception, now: float) -> None:
        name = type(error).__name__
        self.errors[name] = self.errors.get(name, 0) + 1
        self.window.add(now, failed=True)
        self.damage.add(now, failed=not isinstance(error, NoReply))

    def replied(self, reply_s: float, now: float) -> None:
        self.replies += 1
        self.recent.append(reply_s)
        self.window.add(now, failed=False)
        self.damage.add(now, failed=False)


class ErrorWindow:
    """Failures and transactions of the last five minutes, in ten slices."""

    __slots__ = ("_slice", "_slices")

    def __init__(self) -> None:
        self._slices: deque[list[int]] = deque(maxlen=SLICES)
        self._slice = -1

    def add(self, now: float, *, failed: bool) -> None:
        place = int(now * (SLICES / WINDOW_S))
        if place != self._slice:
            self._move(place)
        last = self._slices[-1]
        last[0] += 1
        if failed:
            last[1] += 1

    def _move(self, place: int) -> None:
        missed = min(place - self._slice, SLICES) if self._slice >= 0 else 1
        self._slices.extend([0, 0] for _ in range(max(missed, 1)))
        self._slice = place

    def rate(self, now: float) -> float:
        """Share that failed; 0 where nothing happened."""
        bad = self.count(now)
        total = sum(count for count, _ in self._slices)
        return bad / total if total else 0.0

    def count(self, now: float) -> int:
        """How many failed."""
        if self._slice >= 0 and int(now * (SLICES / WINDOW_S)) > self._slice:
            self._move(int(now * (SLICES / WINDOW_S)))
        return sum(bad for _, bad in self._slices)


@dataclass(frozen=True, slots=True)
class StationStatistics:
    """Since the station was added. Recent reply times, in seconds from our own last bit to the reply's last byte."""

    transactions: int = 0
    replies: int = 0
    bytes_sent: int = 0
    bytes_received: int = 0
    reply_p50_s: float | None = None
    reply_p95_s: float | None = None
    reply_p99_s: float | None = None
    error_rate: float = 0.0
    errors: Mapping[str, int] = field(default_factory=dict)
    """Failures by error class."""
    counters: Mapping[str, int] = field(default_factory=dict)
    """Frames: late, foreign, duplicate, unsolicited, master, echo, collision, retry. Bytes: early, marks."""

    damaged: int = 0
    """Frames of the last 5 minutes that came and were spoiled: what tells of the bit errors that nobody detects
    (RELIABILITY 4, link-quality gate). Silence does not count."""
    damage_rate: float = 0.0
    """Their share of the transactions, 0 to 1."""


@dataclass(frozen=True, slots=True)
class BusStatistics(StationStatistics):
    """A whole bus since it was opened."""

    name: str = ""
    elapsed_s: float = 0.0
    load_percent: float = 0.0
    """Share of recent time in which bytes were on the wire, either way."""
    occupied_percent: float = 0.0
    """Share of recent time in which the bus could take no other frame (frames, waiting, gaps)."""
    transactions_per_s: float = 0.0
    queued: int = 0
    stations: Mapping[int, StationStatistics] = field(default_factory=dict)


class Activity:
    """The most recent transactions of a bus: when each ended, how long it used the wire and kept the bus."""

    __slots__ = ("_recent",)

    def __init__(self) -> None:
        self._recent: deque[tuple[float, float, float]] = deque(maxlen=RECENT)

    def add(self, now: float, wire_s: float, kept_s: float) -> None:
        self._recent.append((now, wire_s, kept_s))

    def figures(self, now: float, since: float) -> tuple[float, float, float]:
        """Load %, occupied %, transactions per second over the last minute at most."""
        earliest = max(since, now - 60.0)
        recent = [entry for entry in self._recent if entry[0] > earliest]
        if not recent:
            return 0.0, 0.0, 0.0
        full = len(recent) == RECENT
        begun = recent[0][0] if full else earliest
        counted = recent[1:] if full else recent
        span = max(now - begun, 1e-9)
        wire = sum(entry[1] for entry in counted)
        kept = sum(entry[2] for entry in counted)
        return min(100.0, 100 * wire / span), min(100.0, 100 * kept / span), len(counted) / span


def figures(counters: Counters, now: float) -> StationStatistics:
    """A picture of the counters."""
    p50, p95, p99 = percentiles(sorted(counters.recent))
    return StationStatistics(
        counters.transactions, counters.replies, counters.bytes_sent, counters.bytes_received, p50, p95, p99,
        counters.window.rate(now), dict(counters.errors), dict(counters.kinds), counters.damage.count(now),
        counters.damage.rate(now),
    )  # fmt: skip


def percentiles(ordered: list[float]) -> tuple[float | None, float | None, float | None]:
    """p50, p95, p99 by nearest rank; None where there is nothing."""
    if not ordered:
        return None, None, None
    last = len(ordered) - 1
    p50, p95, p99 = (ordered[min(last, int(share * len(ordered)))] for share in (0.50, 0.95, 0.99))
    return p50, p95, p99


def snapshot(
    name: str, counters: Counters, activity: Activity, stations: Mapping[int, Counters], *, now: float, since: float,
    queued: int, echoes: int,
) -> BusStatistics:  # fmt: skip
    """The whole bus at ``now``; it was opened at ``since``."""
    load, occupied, rate = activity.figures(now, since)
    whole = figures(counters, now)
    return BusStatistics(
        whole.transactions, whole.replies, whole.bytes_sent, whole.bytes_received, whole.reply_p50_s, whole.reply_p95_s,
        whole.reply_p99_s, whole.error_rate, whole.errors, {**whole.counters, "echo": echoes}, whole.damaged,
        whole.damage_rate, name, now - since, load, occupied, rate, queued,
        {address: figures(one, now) for address, one in stations.items()},
    )  # fmt: skip
