"""Which poll is due, and what a set of polls will cost a line before it is started. Pure; ``now`` is an argument."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from heapq import heapify, heappop, heappush, heapreplace
from typing import TYPE_CHECKING, Any

from drivebus.bus.prepared_request import PreparedRequest
from drivebus.protocols.codec import BusRequest, RequestPriority

if TYPE_CHECKING:
    from drivebus.bus.station import Station
    from drivebus.protocols.codec import StationConfig
    from drivebus.serial_settings import SerialSettings

GOLDEN_RATIO = 0.6180339887498949
"""Multiples of it, modulo 1, spread any number of phases evenly."""


@dataclass(frozen=True, slots=True)
class Poll:
    """A request that is to be sent again and again.

    ``period_s`` 0 means: as often as the bus allows. ``phase_s`` (from the moment of ``watch``) is chosen so that
    polls spread evenly where it is None.
    """

    request: Any
    period_s: float
    phase_s: float | None = None
    tag: Any = None

    def __post_init__(self) -> None:
        if not self.period_s >= 0:
            raise ValueError(f"period {self.period_s} s: expected 0 or more")


class PreparedPoll(PreparedRequest):
    """A poll made ready for the wire; sent again and again."""

    __slots__ = ("cancelled", "due_at", "period_s", "phase_at", "retry_queued")

    def __init__(self, poll: Poll, token: Any, station: Station, settings: SerialSettings, phase_at: float) -> None:
        super().__init__(
            BusRequest(station.address, poll.request, RequestPriority.POLL, tag=poll.tag), token, station, settings
        )
        self.period_s = poll.period_s
        self.phase_at = self.due_at = phase_at
        self.cancelled = False
        self.retry_queued = False
        """Its second attempt waits in the queue: it is not due until that is done."""

    def skip_to(self, now: float) -> None:
        """The next due time after ``now``, in phase: what was missed is not made up for."""
        if self.period_s <= 0:
            self.due_at = now
            return
        self.due_at += self.period_s
        if self.due_at <= now:
            missed = int((now - self.phase_at) / self.period_s)
            self.due_at = self.phase_at + (missed + 1) * self.period_s


class PollSchedule:
    """All polls of a bus, the most overdue first."""

    __slots__ = ("_count", "_heap", "_phase_count")

    def __init__(self) -> None:
        self._heap: list[tuple[float, int, PreparedPoll]] = []
        self._count = 0
        self._phase_count = 0

    def next_phase_s(self, poll: Poll) -> float:
        """Seconds from ``watch`` to the first time."""
        if poll.phase_s is not None:
            return poll.phase_s
        share = (self._phase_count * GOLDEN_RATIO) % 1.0
        self._phase_count += 1
        return share * poll.period_s

    def add(self, job: PreparedPoll, at: float | None = None) -> None:
        """Due at its own time, or at ``at`` this once."""
        self._count += 1
        heappush(self._heap, (job.due_at if at is None else at, self._count, job))

    def next_due(self, now: float) -> PreparedPoll | None:
        """The most overdue poll that may be sent; it stays in the plan. A suspect station's are parked on the way."""
        heap = self._heap
        while heap:
            due, _, job = heap[0]
            if due > now:
                return None
            station = job.station
            if job.cancelled:
                heappop(heap)
            elif station.suspect:
                station.suspended_polls.append(heappop(heap)[2])
            elif job.retry_queued:
                self.mark_sent(job, now)
            else:
                return job
        return None

    def mark_sent(self, job: PreparedPoll, now: float) -> None:
        """``job``, which was first, is being sent (or skipped)."""
        job.skip_to(now)
        self._count += 1
        heapreplace(self._heap, (job.due_at, self._count, job))

    def resume(self, station: Station, now: float) -> None:
        """The station answers again: its polls are due at once, those that were missed once only."""
        for job in station.suspended_polls:
            self.add(job, now)
        station.suspended_polls.clear()

    def cancel_if(self, unwanted: Callable[[PreparedPoll], bool]) -> None:
        """No more of these polls (those that are parked are their stations' affair)."""
        for _, _, job in self._heap:
            if unwanted(job):
                job.cancelled = True
        self._heap = [entry for entry in self._heap if not entry[2].cancelled]
        heapify(self._heap)

    def next_due_at(self) -> float | None:
        return self._heap[0][0] if self._heap else None

    def __len__(self) -> int:
        return len(self._heap)


@dataclass(frozen=True, slots=True)
class DriveLoad:
    """What one drive gets out of a plan. Seconds."""

    refresh_s: float
    """Between two answers to its slowest poll in the long run, while everybody answers at its limit; a single answer
    may come a cycle later."""
    stop_bound_s: float
    """Longest time from asking for a stop to its last bit on the wire (5.1), everybody else alive or not."""


@dataclass(frozen=True, slots=True)
class BusLoad:
    """What a set of polls costs a line."""

    load_percent: float
    """Bus time that the polls ask for if every station uses its whole time to answer; above 100 the periods stretch."""
    cycle_s: float
    """Every poll once, back to back, every station at its limit."""
    drives: Mapping[int, DriveLoad]


def estimate_bus_load(polls: Sequence[tuple[StationConfig, Sequence[Poll]]], settings: SerialSettings) -> BusLoad:
    """Load, refresh and stop bound of a plan, before anything is sent.

    The stop frame is ``link.extra["stop"]`` (a request) where the dialect gives one, else as long as the fence. It
    may also have to wait for what is not polled: fences, and the requests in ``link.extra["longest"]``.
    """
    costs = [(link, poll, _transaction_s(link, poll.request, settings)) for link, many in polls for poll in many]
    cycle_s = sum(cost for _, _, cost in costs)
    load = sum(cost / poll.period_s if poll.period_s > 0 else 1.0 for _, poll, cost in costs)
    others = [
        (link, request) for link, _ in polls for request in (link.sync_request(0), *link.extra.get("longest", ()))
    ]
    asked = [*((link, poll.request) for link, poll, _ in costs), *others]
    longest = max(
        (_transaction_s(link, request, settings) - link.timing.gap_s(settings) for link, request in asked), default=0
    )
    stretch = max(1.0, load)
    drives = {
        link.address: DriveLoad(
            max((max(poll.period_s * stretch, cycle_s if poll.period_s <= 0 else 0.0) for poll in many), default=0.0),
            longest + link.timing.gap_s(settings) + settings.seconds(_stop_frame_bytes(link)),
        )
        for link, many in polls
    }
    return BusLoad(100 * load, cycle_s, drives)


def _transaction_s(link: StationConfig, request: Any, settings: SerialSettings) -> float:
    """Gap, request, and the whole time that may pass until its reply is whole or given up."""
    codec, timing = link.codec, link.timing
    request_s = settings.seconds(len(codec.encode_request(request)))
    return timing.gap_s(settings) + request_s + timing.timeout_s(settings, codec.largest_reply(request))


def _stop_frame_bytes(link: StationConfig) -> int:
    return len(link.codec.encode_request(link.extra.get("stop") or link.sync_request(0)))
