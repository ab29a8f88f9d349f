"""Counting what happens on a bus, cheaply while it runs, and telling it when asked. Pure."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from drivebus.errors import NoReply

RECENT_TRANSACTIONS = 512
"""So many transactions are remembered for the recent figures of a bus."""
RECENT_REPLIES = 128
"""So many reply times are remembered of each station."""
ERROR_WINDOW_S = 300.0
"""Error rates look back so far (RELIABILITY 4: link-quality gate)."""
ERROR_WINDOW_SLICES = 10


class Counters:
    """What one station has seen. A bus keeps one of its own for what belongs to no station; the rest is added up."""

    __slots__ = (
        "bytes_received",
        "bytes_sent",
        "error_window",
        "errors",
        "events",
        "replies",
        "reply_times_s",
        "transactions",
    )

    def __init__(self) -> None:
        self.transactions = 0
        self.replies = 0
        self.bytes_sent = 0
        self.bytes_received = 0
        self.errors: dict[str, int] = {}
        self.events: dict[str, int] = {}
        self.reply_times_s: deque[float] = deque(maxlen=RECENT_REPLIES)
        self.error_window = ErrorWindow()

    def count_event(self, name: str, amount: int = 1) -> None:
        self.events[name] = self.events.get(name, 0) + amount

    def record_failure(self, error: Exception, now: float) -> None:
        name = type(error).__name__
        self.errors[name] = self.errors.get(name, 0) + 1
        self.error_window.add(now, NO_REPLY if isinstance(error, NoReply) else DAMAGED)

    def record_reply(self, reply_s: float, now: float) -> None:
        self.replies += 1
        self.reply_times_s.append(reply_s)
        self.error_window.add(now, GOOD)


GOOD, NO_REPLY, DAMAGED = range(3)


class ErrorWindow:
    """How the transactions of the last five minutes ended, in ten slices."""

    __slots__ = ("_current", "_ends_at", "_slices")

    def __init__(self) -> None:
        self._slices: deque[list[int]] = deque(maxlen=ERROR_WINDOW_SLICES)
        self._current = [0, 0, 0]
        self._ends_at = float("-inf")

    def add(self, now: float, ending: int) -> None:
        if now >= self._ends_at:
            self._advance(now)
        self._current[ending] += 1

    def _advance(self, now: float) -> None:
        """A slice begins with the first event after the last one's end; what nobody used counts as empty slices."""
        slice_s = ERROR_WINDOW_S / ERROR_WINDOW_SLICES
        missed = int(min(float(ERROR_WINDOW_SLICES), (now - self._ends_at) / slice_s))
        self._slices.extend([0, 0, 0] for _ in range(1 + missed))
        self._current = self._slices[-1]
        self._ends_at = now + slice_s

    def totals(self, now: float) -> tuple[int, int, int]:
        """Good, silent and damaged ones."""
        if now >= self._ends_at:
            self._advance(now)
        good, silent, damaged = map(sum, zip(*self._slices, strict=True))
        return good, silent, damaged

    def rates(self, now: float) -> tuple[float, int, float]:
        """Share that failed, how many were damaged, and their share; 0 where nothing happened."""
        totals = self.totals(now)
        failed, damaged = _rates(totals)
        return failed, totals[DAMAGED], damaged


def _rates(totals: tuple[int, int, int]) -> tuple[float, float]:
    """Failed, and damaged, of all."""
    count = sum(totals)
    return ((totals[NO_REPLY] + totals[DAMAGED]) / count, totals[DAMAGED] / count) if count else (0.0, 0.0)


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
    load_percent: float = 0.0
    """Share of recent time in which bytes were on the wire, either way."""
    occupied_percent: float = 0.0
    """Share of recent time in which the bus could take no other frame (frames, waiting, gaps)."""
    transactions_per_s: float = 0.0
    """In the same recent time as the whole bus's, so that the drives of a bus add up to it."""


@dataclass(frozen=True, slots=True)
class BusStatistics(StationStatistics):
    """A whole bus since it was first opened."""

    name: str = ""
    elapsed_s: float = 0.0
    queued: int = 0
    stations: Mapping[int, StationStatistics] = field(default_factory=dict)


class BusShare(NamedTuple):
    """What somebody took of a bus's recent time: load %, occupied %, transactions per second."""

    load_percent: float = 0.0
    occupied_percent: float = 0.0
    transactions_per_s: float = 0.0


NO_SHARE = BusShare()


class RecentActivity:
    """The most recent transactions of a bus: when each ended, how long it used the wire and kept the bus, and whose."""

    __slots__ = ("_recent",)

    def __init__(self) -> None:
        self._recent: deque[tuple[float, float, float, Counters]] = deque(maxlen=RECENT_TRANSACTIONS)

    def add(self, now: float, wire_s: float, kept_s: float, station: Counters) -> None:
        self._recent.append((now, wire_s, kept_s, station))

    def shares(self, now: float, since: float) -> dict[Counters | None, BusShare]:
        """Of the whole bus (None) and of each station that was spoken to, over the last minute at most."""
        earliest = max(since, now - 60.0)
        recent = [entry for entry in self._recent if entry[0] > earliest]
        full = len(recent) == RECENT_TRANSACTIONS
        begun = recent[0][0] if full else earliest
        span = max(now - begun, 1e-9)
        sums: dict[Counters | None, tuple[float, float, int]] = {}
        for _, wire_s, kept_s, station in recent[full:]:
            for whose in (None, station):
                wire, kept, count = sums.get(whose, (0.0, 0.0, 0))
                sums[whose] = wire + wire_s, kept + kept_s, count + 1
        return {
            whose: BusShare(min(100.0, 100 * wire / span), min(100.0, 100 * kept / span), count / span)
            for whose, (wire, kept, count) in sums.items()
        }


def station_snapshot(counters: Counters, share: BusShare, now: float) -> StationStatistics:
    """A picture of one station's counters and of its share of the bus."""
    p50, p95, p99 = percentiles(sorted(counters.reply_times_s))
    failed, damaged, damage_rate = counters.error_window.rates(now)
    return StationStatistics(
        counters.transactions,
        counters.replies,
        counters.bytes_sent,
        counters.bytes_received,
        p50,
        p95,
        p99,
        failed,
        dict(counters.errors),
        dict(counters.events),
        damaged,
        damage_rate,
        *share,
    )


def percentiles(ordered: list[float]) -> tuple[float | None, float | None, float | None]:
    """p50, p95, p99 by nearest rank; None where there is nothing."""
    if not ordered:
        return None, None, None
    p50, p95, p99 = (ordered[-(-percent * len(ordered) // 100) - 1] for percent in (50, 95, 99))
    return p50, p95, p99


def bus_snapshot(
    name: str,
    counters: Counters,
    activity: RecentActivity,
    stations: Mapping[int, Counters],
    *,
    now: float,
    first_opened_at: float,
    opened_at: float,
    queued: int,
    echoes: int,
) -> BusStatistics:
    """The whole bus at ``now``, first opened at ``begun``, last at ``since``. ``counters``: no station's (any more)."""
    shares = activity.shares(now, opened_at)
    everyone = [counters, *stations.values()]
    good, silent, spoiled = (
        sum(ending) for ending in zip(*(one.error_window.totals(now) for one in everyone), strict=True)
    )
    failed, damaged = _rates((good, silent, spoiled))
    p50, p95, p99 = percentiles(sorted(reply_s for one in everyone for reply_s in one.reply_times_s))
    return BusStatistics(
        sum(one.transactions for one in everyone),
        sum(one.replies for one in everyone),
        sum(one.bytes_sent for one in everyone),
        counters.bytes_received,
        p50,
        p95,
        p99,
        failed,
        dict(counters.errors),
        {**counters.events, "echo": echoes},
        spoiled,
        damaged,
        *shares.get(None, NO_SHARE),
        name,
        now - first_opened_at,
        queued,
        {address: station_snapshot(one, shares.get(one, NO_SHARE), now) for address, one in stations.items()},
    )


def merge_counters(counters: Counters, station: Counters) -> None:
    """A station leaves; what it counted stays in the sums of its bus."""
    counters.transactions += station.transactions
    counters.replies += station.replies
    counters.bytes_sent += station.bytes_sent
