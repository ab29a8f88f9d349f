"""Counters and statistics of a bus: cheap to update, computed when they are read."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from drivebus.errors import NoReply

RECENT_TRANSACTIONS = 512  # transactions kept for the recent load of a bus
RECENT_REPLIES = 128  # reply times kept of each station
LOAD_WINDOW_S = 60.0  # the recent load looks back no further
ERROR_WINDOW_S = 300.0  # error rates look back five minutes
ERROR_WINDOW_SLICES = 10

GOOD, NO_REPLY, DAMAGED = range(3)  # results of a transaction, as index of an ErrorWindow's slice


class ErrorWindow:
    """Results of the transactions of the last five minutes, in ten slices."""

    __slots__ = ("_current", "_ends_at", "_slices")

    def __init__(self) -> None:
        self._slices: deque[list[int]] = deque(maxlen=ERROR_WINDOW_SLICES)
        self._current = [0, 0, 0]
        self._ends_at = float("-inf")

    def add(self, now: float, result: int) -> None:
        """Count one transaction: GOOD, NO_REPLY or DAMAGED."""
        if now >= self._ends_at:
            self._advance(now)
        self._current[result] += 1

    def _advance(self, now: float) -> None:
        """Begin a slice at the first event after the end of the last slice, with empty slices for the time between."""
        slice_s = ERROR_WINDOW_S / ERROR_WINDOW_SLICES
        missed = int(min(float(ERROR_WINDOW_SLICES), (now - self._ends_at) / slice_s))
        self._slices.extend([0, 0, 0] for _ in range(1 + missed))
        self._current = self._slices[-1]
        self._ends_at = now + slice_s

    def totals(self, now: float) -> tuple[int, int, int]:
        """Return the numbers of good, unanswered and damaged transactions."""
        if now >= self._ends_at:
            self._advance(now)
        good, unanswered, damaged = map(sum, zip(*self._slices, strict=True))
        return good, unanswered, damaged

    def rates(self, now: float) -> ErrorRates:
        """Return the rates of the last five minutes."""
        return error_rates(*self.totals(now))


class ErrorRates(NamedTuple):
    """Share of the transactions that failed, and number and share of the damaged ones."""

    error_rate: float
    damaged: int
    damage_rate: float


def error_rates(good: int, unanswered: int, damaged: int) -> ErrorRates:
    """Return the rates of these numbers of transactions; 0 without any."""
    count = good + unanswered + damaged
    return ErrorRates((unanswered + damaged) / count, damaged, damaged / count) if count else ErrorRates(0.0, 0, 0.0)


class Counters:
    """Counters of one station, or of the events of a bus that belong to no station."""

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
        """Failures by error class."""
        self.events: dict[str, int] = {}
        self.reply_times_s: deque[float] = deque(maxlen=RECENT_REPLIES)
        self.error_window = ErrorWindow()

    def count_event(self, name: str, amount: int = 1) -> None:
        """Count an event by its name."""
        self.events[name] = self.events.get(name, 0) + amount

    def record_failure(self, error: Exception, now: float) -> None:
        """Count a failed transaction."""
        name = type(error).__name__
        self.errors[name] = self.errors.get(name, 0) + 1
        self.error_window.add(now, NO_REPLY if isinstance(error, NoReply) else DAMAGED)

    def record_reply(self, reply_s: float, now: float) -> None:
        """Count an accepted reply that took ``reply_s`` from our last bit to its last byte."""
        self.replies += 1
        self.reply_times_s.append(reply_s)
        self.error_window.add(now, GOOD)


@dataclass(frozen=True, slots=True, kw_only=True)
class StationStatistics:
    """Statistics since the station was added. Reply times in seconds from our last bit to the reply's last byte."""

    transactions: int = 0
    replies: int = 0
    bytes_sent: int = 0
    bytes_received: int = 0
    reply_p50_s: float | None = None
    reply_p95_s: float | None = None
    reply_p99_s: float | None = None
    error_rate: float = 0.0
    """Share of the last 5 minutes' transactions that failed, 0 to 1."""
    errors: Mapping[str, int] = field(default_factory=dict)
    """Failures by error class."""
    counters: Mapping[str, int] = field(default_factory=dict)
    """Frames: foreign, late, duplicate, unsolicited, foreign_request, echo, collision, retry, no_silence. Bytes:
    before_tx_end, line_errors."""
    damaged: int = 0
    """Transactions of the last 5 minutes whose reply was damaged: a measure of the bit errors that no check detects.
    A missing reply does not count."""
    damage_rate: float = 0.0
    """Share of damaged transactions, 0 to 1."""
    load_percent: float = 0.0
    """Share of the last minute in which bytes were on the wire, in either direction."""
    occupied_percent: float = 0.0
    """Share of the last minute in which the bus could take no other frame (frames, waits, gaps)."""
    transactions_per_s: float = 0.0
    """Transactions of the last minute per second; those of the stations add up to that of the bus."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BusStatistics(StationStatistics):
    """Statistics of a whole bus since it was first opened."""

    name: str = ""
    elapsed_s: float = 0.0
    queued: int = 0
    stations: Mapping[int, StationStatistics] = field(default_factory=dict)


class BusShare(NamedTuple):
    """Share of a bus's recent time."""

    load_percent: float = 0.0
    occupied_percent: float = 0.0
    transactions_per_s: float = 0.0


class RecentActivity(deque[tuple[float, float, float, Counters]]):
    """The most recent transactions of a bus.

    Each with its end, the seconds of its bytes on the wire, the seconds in which no other frame could be sent, and the
    counters of its station.
    """

    def __init__(self) -> None:
        super().__init__(maxlen=RECENT_TRANSACTIONS)

    def shares(self, now: float, since: float) -> dict[Counters | None, BusShare]:
        """Return the shares of the whole bus (None) and of each station, over the last minute at most."""
        started_at = max(since, now - LOAD_WINDOW_S)
        recent = [transaction for transaction in self if transaction[0] > started_at]
        if len(recent) == RECENT_TRANSACTIONS:  # those before are no longer known: count from the end of the first
            started_at, *_ = recent.pop(0)
        span_s = max(now - started_at, 1e-9)
        sums: dict[Counters | None, tuple[float, float, int]] = {}
        for _, wire_s, occupied_s, station in recent:
            for owner in (None, station):
                wire_sum_s, occupied_sum_s, count = sums.get(owner, (0.0, 0.0, 0))
                sums[owner] = wire_sum_s + wire_s, occupied_sum_s + occupied_s, count + 1
        return {
            owner: BusShare(
                load_percent=min(100.0, 100 * wire_s / span_s),
                occupied_percent=min(100.0, 100 * occupied_s / span_s),
                transactions_per_s=count / span_s,
            )
            for owner, (wire_s, occupied_s, count) in sums.items()
        }


def station_snapshot(counters: Counters, share: BusShare, now: float) -> StationStatistics:
    """Return the statistics of one station."""
    p50, p95, p99 = percentiles(sorted(counters.reply_times_s))
    return StationStatistics(
        transactions=counters.transactions,
        replies=counters.replies,
        bytes_sent=counters.bytes_sent,
        bytes_received=counters.bytes_received,
        reply_p50_s=p50,
        reply_p95_s=p95,
        reply_p99_s=p99,
        errors=dict(counters.errors),
        counters=dict(counters.events),
        **counters.error_window.rates(now)._asdict(),
        **share._asdict(),
    )


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
    """Return the statistics of a bus. ``counters``: those of events without a registered station."""
    shares = activity.shares(now, opened_at)
    all_counters = [counters, *stations.values()]
    totals = zip(*(item.error_window.totals(now) for item in all_counters), strict=True)
    rates = error_rates(*(sum(counts) for counts in totals))
    p50, p95, p99 = percentiles(sorted(reply_s for item in all_counters for reply_s in item.reply_times_s))
    return BusStatistics(
        transactions=sum(item.transactions for item in all_counters),
        replies=sum(item.replies for item in all_counters),
        bytes_sent=sum(item.bytes_sent for item in all_counters),
        bytes_received=counters.bytes_received,
        reply_p50_s=p50,
        reply_p95_s=p95,
        reply_p99_s=p99,
        errors=dict(counters.errors),
        counters={**counters.events, "echo": echoes},
        name=name,
        elapsed_s=now - first_opened_at,
        queued=queued,
        stations={
            address: station_snapshot(station, shares.get(station, BusShare()), now)
            for address, station in stations.items()
        },
        **rates._asdict(),
        **shares.get(None, BusShare())._asdict(),
    )


def percentiles(ordered: list[float]) -> tuple[float | None, float | None, float | None]:
    """Return p50, p95 and p99 by nearest rank, None for an empty list."""
    if not ordered:
        return None, None, None
    p50, p95, p99 = (ordered[-(-percent * len(ordered) // 100) - 1] for percent in (50, 95, 99))
    return p50, p95, p99


def merge_counters(counters: Counters, station: Counters) -> None:
    """Add the counters of a station that leaves the bus to those of the bus."""
    counters.transactions += station.transactions
    counters.replies += station.replies
    counters.bytes_sent += station.bytes_sent
