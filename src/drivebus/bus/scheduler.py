"""Choice of the next frame. ``now`` is an argument; choosing removes only requests that are expired or not permitted.

Priorities: stop > command > stop read > parameter > poll > probe, first in first out within a priority. Five fairness
rules:

* after four commands a waiting stop read or parameter request goes first;
* after two stop reads a waiting parameter request goes first: the reads by which a start detects an overspeed have this
  priority, and drives on a long ramp are read again and again;
* after four commands, stop reads or parameter requests in a row a due sync probe or poll goes first, so that values
  stay fresh during a parameter backup;
* the sync probe of an offline station goes before polls, but only within its 10 % share of the bus, so that a full
  bus still finds a drive that comes back;
* after nine polls in a row a waiting request of priority probe (a scan) goes first.

The sync probe that a request waits for has its priority, and counts like it: else those of silent stations, which are
due again and again, would take all turns.

A stop is the next frame: it waits only for the frame on the wire and the gap. Where several stations are to be
stopped, the one whose last stop is longest ago goes first, so that no stop waits for the repetitions of another.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Iterable
from heapq import heapify, heappop, heappush, heapreplace
from math import inf

from drivebus.bus.messages import BusRequest, RequestPriority
from drivebus.bus.prepared_request import MOTION_EFFECT, NO_EFFECT, Poll, PreparedPoll, PreparedRequest
from drivebus.bus.station import ProbeBudget, Station
from drivebus.errors import Expired
from drivebus.serial_settings import SerialSettings

# constants, because reading a member from its class takes four times as long
STOP, COMMAND, STOP_READ, PARAMETER, POLL, PROBE = RequestPriority
MAX_COMMANDS_IN_ROW = 4  # then a waiting stop read, parameter request, sync probe or poll goes first
MAX_STOP_READS_IN_ROW = 2  # then a waiting parameter request goes first; after 1 a bus stop would be confirmed too late
MAX_POLLS_IN_ROW = 9  # then a waiting request of priority probe goes first
GOLDEN_RATIO = 0.6180339887498949  # its multiples modulo 1 spread any number of phases evenly


class PollSchedule:
    """All polls of a bus, the most overdue first."""

    __slots__ = ("_count", "_phase_count", "heap", "suspended")

    def __init__(self) -> None:
        self.heap: list[tuple[float, int, PreparedPoll]] = []
        """Due time, order of scheduling, poll."""
        self._count = 0
        self._phase_count = 0
        self.suspended: dict[Station, list[PreparedPoll]] = {}
        """Polls of suspect stations; due again when the station replies."""

    def next_phase_s(self, poll: Poll) -> float:
        """Return the seconds from the start of polling to the first time."""
        if poll.phase_s is not None:
            return poll.phase_s
        share = (self._phase_count * GOLDEN_RATIO) % 1.0
        self._phase_count += 1
        return share * poll.period_s

    def add(self, poll: PreparedPoll, at: float | None = None) -> None:
        """Add a poll, due at its own time, or at ``at`` this once."""
        self._count += 1
        heappush(self.heap, (poll.due_at if at is None else at, self._count, poll))

    def next_due(self, now: float) -> PreparedPoll | None:
        """Return the most overdue poll that may be sent; it stays scheduled. Suspend polls of suspect stations."""
        heap = self.heap
        while heap:
            due_at, _, poll = heap[0]
            if due_at > now:
                return None
            station = poll.station
            if poll.cancelled:
                heappop(heap)
            elif station.state.is_suspect:
                self.suspended.setdefault(station, []).append(heappop(heap)[2])
            elif poll.retry_queued:
                self.mark_sent(poll, now)
            else:
                return poll
        return None

    def mark_sent(self, poll: PreparedPoll, now: float) -> None:
        """Set the next due time of the first poll, which is being sent or skipped."""
        poll.skip_to(now)
        self._count += 1
        heapreplace(self.heap, (poll.due_at, self._count, poll))

    def resume(self, station: Station, now: float) -> None:
        """Make the suspended polls of a station due now, each once however many times it was missed."""
        for poll in self.suspended.pop(station, ()):
            self.add(poll, now)

    def make_due(self, matches: Callable[[PreparedPoll], bool], now: float) -> None:
        """Make polls due now that are due later; their periods count from now."""
        for place, (due_at, count, poll) in enumerate(self.heap):
            if due_at > now and matches(poll):
                poll.due_at = poll.phase_at = now
                self.heap[place] = (now, count, poll)
        heapify(self.heap)

    def cancel_if(self, unwanted: Callable[[PreparedPoll], bool]) -> None:
        """Remove polls, suspended ones too."""
        for _, _, poll in self.heap:
            if unwanted(poll):
                poll.cancelled = True
        self.heap = [entry for entry in self.heap if not entry[2].cancelled]
        heapify(self.heap)
        for station, polls in list(self.suspended.items()):
            self.suspended[station] = [poll for poll in polls if not unwanted(poll)]

    def next_due_at(self) -> float:
        """Return when the most overdue poll is due, inf without polls."""
        return self.heap[0][0] if self.heap else inf


class Scheduler:
    """Queues and polls of one bus."""

    __slots__ = (
        "_commands_in_row",
        "_last_stop_at",
        "_pending_sync_probes",
        "_polls_in_row",
        "_settings",
        "_stop_reads_in_row",
        "_urgent_in_row",
        "next_wake_at",
        "poll_schedule",
        "probe_budget",
        "queues",
        "rejected",
        "untrusted_stations",
    )

    def __init__(self, settings: SerialSettings) -> None:
        self._settings = settings
        self.queues: tuple[deque[PreparedRequest], ...] = tuple(deque() for _ in RequestPriority)
        self.poll_schedule = PollSchedule()
        self.probe_budget = ProbeBudget()
        self.untrusted_stations: list[Station] = []
        """Stations that need a sync probe."""
        self.rejected: list[tuple[PreparedRequest, Exception]] = []
        """Requests that ``next`` has removed, and why."""
        self.next_wake_at = inf
        """Time at which ``next`` may return another frame without a new event."""
        self._commands_in_row = self._stop_reads_in_row = self._urgent_in_row = self._polls_in_row = 0
        self._last_stop_at: dict[Station, float] = {}
        self._pending_sync_probes: dict[Station, PreparedRequest] = {}

    def enqueue(self, prepared: PreparedRequest) -> None:
        """Queue a request by its priority."""
        self.queues[prepared.priority].append(prepared)

    def requeue(self, prepared: PreparedRequest) -> None:
        """Queue one more attempt: first of its priority, but a stop lets the stops of other drives go first."""
        if prepared.priority is STOP:
            self.queues[prepared.priority].append(prepared)
        else:
            self.queues[prepared.priority].appendleft(prepared)

    def next(self, now: float) -> PreparedRequest | None:
        """Return the request to send next (its gap may still have to pass), or None.

        A stop that was requested with another priority (the levels that follow the stop pulse of a VC660) lets stops
        go first.
        """
        self.next_wake_at = inf
        stops, commands, stop_reads, parameters, polls, probes = self.queues
        if stops:
            return min(stops, key=self._stop_order)
        polling = polls or self.poll_schedule.heap
        if (
            self._urgent_in_row >= MAX_COMMANDS_IN_ROW
            and (polling or self.untrusted_stations)
            and (chosen := self._next_background(polls, now))
        ):
            return chosen
        if commands or stop_reads or parameters:
            queues = (commands, stop_reads, parameters)
            if self._stop_reads_in_row >= MAX_STOP_READS_IN_ROW:
                queues = (commands, parameters, stop_reads)
            if self._commands_in_row >= MAX_COMMANDS_IN_ROW:
                queues = (*queues[1:], commands)
            for queue in queues:
                if queue and (chosen := self._next_sendable(queue, now)):
                    return chosen
        if self.untrusted_stations and (chosen := self._next_sync_probe(now)):
            return chosen
        if probes and self._polls_in_row >= MAX_POLLS_IN_ROW and (chosen := self._next_sendable(probes, now)):
            return chosen
        if polling and (chosen := self._next_poll(polls, now)):
            return chosen
        return self._next_sendable(probes, now) if probes else None

    def on_sent(self, prepared: PreparedRequest, now: float) -> None:
        """Remove the request that is being sent from its queue and count it for fairness."""
        if prepared.is_sync_probe:
            self._pending_sync_probes.pop(prepared.station, None)
        elif isinstance(prepared, PreparedPoll) and not prepared.retry_queued:
            self.poll_schedule.mark_sent(prepared, now)
        else:
            if isinstance(prepared, PreparedPoll):
                prepared.retry_queued = False
            self.queues[prepared.priority].remove(prepared)
        priority = prepared.priority
        if priority is STOP and not prepared.is_broadcast:
            self._last_stop_at[prepared.station] = now
        urgent = priority is PARAMETER or priority is COMMAND or priority is STOP_READ
        self._urgent_in_row = self._urgent_in_row + 1 if urgent else 0
        if priority is PARAMETER:
            self._commands_in_row = self._stop_reads_in_row = 0
        elif priority is STOP_READ:
            self._commands_in_row = 0
            self._stop_reads_in_row += 1
        elif priority is COMMAND and (self.queues[PARAMETER] or self.queues[STOP_READ]):
            self._commands_in_row += 1
        self._polls_in_row = self._polls_in_row + 1 if priority is POLL else 0

    def is_queued(self, token: object) -> bool:
        """Return whether a request of this token waits in a queue, for its first or for another attempt."""
        return any(prepared.token is token for queue in self.queues for prepared in queue)

    def remove_if(self, unwanted: Callable[[PreparedRequest], bool]) -> list[PreparedRequest]:
        """Remove requests from the queues (not from the poll schedule) and return them."""
        removed: list[PreparedRequest] = []
        for queue in self.queues:
            matching = [prepared for prepared in queue if unwanted(prepared)]
            for prepared in matching:
                queue.remove(prepared)
                if isinstance(prepared, PreparedPoll):
                    prepared.retry_queued = False
            removed += matching
        return removed

    def supersede(self, stations: Iterable[Station]) -> list[PreparedRequest]:
        """Void every older permit of stations that are being stopped; return their queued commands, removed."""
        stopped = set(stations)
        for station in stopped:
            station.stop_epoch += 1
        return self.remove_commands(stopped)

    def remove_commands(self, stations: Collection[Station]) -> list[PreparedRequest]:
        """Remove the queued commands of stations and return them."""
        return self.remove_if(lambda prepared: prepared.station in stations and _is_command(prepared))

    def remove_station(self, station: Station) -> None:
        """Forget a station that leaves the bus."""
        self.poll_schedule.cancel_if(lambda poll: poll.station is station)
        self.poll_schedule.suspended.pop(station, None)
        self._last_stop_at.pop(station, None)
        self._pending_sync_probes.pop(station, None)
        if station in self.untrusted_stations:
            self.untrusted_stations.remove(station)

    def mark_suspect(self, station: Station, now: float) -> None:
        """Quarantine a station whose late reply may be on its way, and schedule its sync probe."""
        station.mark_suspect(now)
        if station not in self.untrusted_stations:
            self.untrusted_stations.append(station)

    def mark_trusted(self, station: Station, now: float) -> None:
        """End the sync probes of a station and resume its polls."""
        if station in self.untrusted_stations:
            self.untrusted_stations.remove(station)
        self.poll_schedule.resume(station, now)

    def __len__(self) -> int:
        return sum(len(queue) for queue in self.queues)

    def _next_sendable(self, queue: deque[PreparedRequest], now: float) -> PreparedRequest | None:
        """Return the first request of a queue that may be sent, or the sync probe that it has to wait for."""
        head = queue[0]
        if head.effect is NO_EFFECT and head.expires_at is None and not head.station.state.is_suspect:
            return head
        for prepared in tuple(queue):
            if self._reject_if_stale(queue, prepared, now):
                continue
            station = prepared.station
            if not station.state.is_suspect:
                return prepared
            if now >= station.quarantined_until:
                return self._sync_probe(station, now, prepared.priority)
            self._wake_no_later_than(station.quarantined_until)
        return None

    def _reject_if_stale(self, queue: deque[PreparedRequest], prepared: PreparedRequest, now: float) -> bool:
        """Reject a request that has expired or lost its permit; nothing of it is sent."""
        error: Exception | None = None
        if prepared.expires_at is not None:
            if now > prepared.expires_at:
                late_ms = round((now - prepared.expires_at) * 1000)
                error = Expired("bus.expired", station=prepared.station.address, late_ms=late_ms)
            else:
                self._wake_no_later_than(prepared.expires_at + 1e-3)
        error = error or prepared.permit_error(now)
        if error is None:
            return False
        queue.remove(prepared)
        self.rejected.append((prepared, error))
        return True

    def _stop_order(self, prepared: PreparedRequest) -> tuple[bool, bool, float]:
        """Sort key of stops; equal ones stay in the order of their requests."""
        other_priority = prepared.bus_request.priority is not STOP
        return other_priority, not prepared.is_broadcast, self._last_stop_at.get(prepared.station, 0.0)

    def _next_background(self, polls: deque[PreparedRequest], now: float) -> PreparedRequest | None:
        probe = self._next_sync_probe(now) if self.untrusted_stations else None
        return probe or self._next_poll(polls, now)

    def _next_poll(self, retries: deque[PreparedRequest], now: float) -> PreparedRequest | None:
        if retries and (retry := self._next_sendable(retries, now)):
            return retry
        if poll := self.poll_schedule.next_due(now):
            return poll
        self._wake_no_later_than(self.poll_schedule.next_due_at())
        return None

    def _next_sync_probe(self, now: float) -> PreparedRequest | None:
        """Return the sync probe that is most overdue: of a suspect station, or of an offline one within the budget."""
        budget_at = self.probe_budget.allowed_at
        best: Station | None = None
        for station in self.untrusted_stations:
            at = station.sync_due_at(budget_at)
            if at > now:
                self._wake_no_later_than(at)
            elif best is None or _sync_due_since(station) < _sync_due_since(best):
                best = station
        return None if best is None else self._sync_probe(best, now, PROBE)

    def _sync_probe(self, station: Station, now: float, priority: RequestPriority) -> PreparedRequest:
        """Return a station's sync probe, the same one until it is sent. ``priority``: that of what waits for it."""
        pending = self._pending_sync_probes.get(station)
        if pending is None:
            request = station.next_sync_request(now)
            bus_request = BusRequest(station=station.address, request=request)
            pending = PreparedRequest(bus_request, None, station, self._settings, is_sync_probe=True)
            self._pending_sync_probes[station] = pending
        pending.priority = priority
        return pending

    def _wake_no_later_than(self, at: float) -> None:
        if at < self.next_wake_at:
            self.next_wake_at = at


def _sync_due_since(station: Station) -> float:
    return station.next_probe_at if station.state.is_unreachable else station.quarantined_until


def _is_command(prepared: PreparedRequest) -> bool:
    """Return whether a request is withdrawn with the commands of its station; a stop, of another priority, never is."""
    return prepared.priority is COMMAND or prepared.effect is MOTION_EFFECT
