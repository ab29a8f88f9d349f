"""Whose frame is next. Pure; ``now`` is an argument; looking changes nothing but what is too old or forbidden.

Lanes: stop > command > parameter > poll > probe, first come first served within a lane. Four fairness rules:

* after four commands a waiting parameter gets a turn (what confirms a stop is read there, G07);
* after four commands or parameters in a row a due fence or poll gets a turn (values must not grow stale during a
  backup, I4);
* a silent station's probe goes before polls, but only within the 10 % budget (else a full bus would never find
  a drive that came back, G08);
* after nine polls in a row a waiting ask of the probe lane (a scan) gets a turn.

A stop is the next frame (I3): it waits for nothing but the frame on the wire and the gap. It deletes its station's
queued commands and ends every permit granted before it. Where several stations are to be stopped, the one whose last
stop is longest ago is next, so that nobody's stop waits for another one's repetitions.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from drivebus.bus.poll_schedule import PollSchedule, PreparedPoll
from drivebus.bus.prepared_request import PreparedRequest
from drivebus.bus.station import ProbeBudget, Station
from drivebus.errors import Expired
from drivebus.protocols.codec import Effect, RequestPriority

if TYPE_CHECKING:
    from drivebus.serial_settings import SerialSettings

NEVER = float("inf")
MAX_COMMANDS_IN_ROW = 4
MAX_POLLS_IN_ROW = 9


class Scheduler:
    """The queues of one bus. ``wake_at``: when the last ``next`` may answer differently without anything new."""

    __slots__ = (
        "_commands_in_row",
        "_last_stop_at",
        "_polls_in_row",
        "_settings",
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
        """Stations that owe a fence: suspect or dead."""
        self.rejected: list[tuple[PreparedRequest, Exception]] = []
        self.next_wake_at = NEVER
        self._commands_in_row = self._urgent_in_row = 0
        self._polls_in_row = 0
        self._last_stop_at: dict[Station, float] = {}
        """When each station's last stop left."""

    def enqueue(self, job: PreparedRequest) -> None:
        self.queues[job.priority].append(job)

    def requeue(self, job: PreparedRequest) -> None:
        """One more attempt: first in its lane, but a stop lets the other drives' stops go first."""
        if job.priority is RequestPriority.STOP:
            self.queues[job.priority].append(job)
        else:
            self.queues[job.priority].appendleft(job)

    def next(self, now: float) -> PreparedRequest | None:
        """The frame that is to be sent next (its gap may still have to pass), or None.

        A stop that was asked for in another lane (the levels that follow a VC660's stop pulse) lets stops go first.
        """
        self.next_wake_at = NEVER
        stops, commands, parameters, polls, probes = self.queues
        if stops:
            return min(stops, key=self._stop_order)
        if self._urgent_in_row >= MAX_COMMANDS_IN_ROW and (job := self._next_background(polls, now)):
            return job
        for lane in (parameters, commands) if self._commands_in_row >= MAX_COMMANDS_IN_ROW else (commands, parameters):
            if lane and (job := self._next_sendable(lane, now)):
                return job
        if self.untrusted_stations and (job := self._next_sync_probe(now)):
            return job
        if probes and self._polls_in_row >= MAX_POLLS_IN_ROW and (job := self._next_sendable(probes, now)):
            return job
        if job := self._next_poll(polls, now):
            return job
        return self._next_sendable(probes, now) if probes else None

    def on_sent(self, job: PreparedRequest, now: float) -> None:
        """``job`` is being sent."""
        if job.is_sync_probe:
            job.station.pending_sync_probe = None
        elif isinstance(job, PreparedPoll) and not job.retry_queued:
            self.poll_schedule.mark_sent(job, now)
        else:
            if isinstance(job, PreparedPoll):
                job.retry_queued = False
            self.queues[job.priority].remove(job)
        lane = job.priority
        if lane is RequestPriority.STOP and not job.is_broadcast:
            self._last_stop_at[job.station] = now
        self._urgent_in_row = (
            self._urgent_in_row + 1 if lane is RequestPriority.PARAMETER or lane is RequestPriority.COMMAND else 0
        )
        if lane is RequestPriority.PARAMETER:
            self._commands_in_row = 0
        elif lane is RequestPriority.COMMAND and self.queues[RequestPriority.PARAMETER]:
            self._commands_in_row += 1
        self._polls_in_row = self._polls_in_row + 1 if lane is RequestPriority.POLL else 0

    def remove_if(self, unwanted: Callable[[PreparedRequest], bool]) -> list[PreparedRequest]:
        """Take jobs out of the queues (not out of the plan)."""
        gone: list[PreparedRequest] = []
        for lane in self.queues:
            found = [job for job in lane if unwanted(job)]
            for job in found:
                lane.remove(job)
                if isinstance(job, PreparedPoll):
                    job.retry_queued = False
            gone += found
        return gone

    def supersede(self, stations: Iterable[Station]) -> list[PreparedRequest]:
        """A stop for these stations: their queued commands go, and every older permit is void (6.5)."""
        stopped = set(stations)
        for station in stopped:
            station.stop_epoch += 1
        return self.remove_if(lambda job: job.station in stopped and _is_command(job))

    def remove_station(self, station: Station) -> None:
        """The station is no longer of this bus."""
        self.poll_schedule.cancel_if(lambda job: job.station is station)
        self._last_stop_at.pop(station, None)
        station.suspended_polls.clear()
        if station in self.untrusted_stations:
            self.untrusted_stations.remove(station)

    def mark_suspect(self, station: Station) -> None:
        if station not in self.untrusted_stations:
            self.untrusted_stations.append(station)

    def mark_trusted(self, station: Station, now: float) -> None:
        if station in self.untrusted_stations:
            self.untrusted_stations.remove(station)
        self.poll_schedule.resume(station, now)

    def __len__(self) -> int:
        return sum(len(lane) for lane in self.queues)

    def _next_sendable(self, lane: deque[PreparedRequest], now: float) -> PreparedRequest | None:
        """The first of a lane that may be sent; a suspect station's fence goes in its place."""
        head = lane[0]
        if (
            not head.station.suspect
            and head.expires_at is None
            and head.permit is None
            and head.permit_error(now) is None
        ):
            return head
        for job in tuple(lane):
            if self._reject_if_stale(lane, job, now):
                continue
            station = job.station
            if not station.suspect:
                return job
            if now >= station.quarantined_until:
                return station.sync_probe(self._settings)
            self._wake_no_later_than(station.quarantined_until)
        return None

    def _reject_if_stale(self, lane: deque[PreparedRequest], job: PreparedRequest, now: float) -> bool:
        """Refuse what is too old (ruling 12) or has lost its permit (I1); nothing is sent of it."""
        error: Exception | None = None
        if job.expires_at is not None:
            if now > job.expires_at:
                late_ms = round((now - job.expires_at) * 1000)
                error = Expired("bus.expired", station=job.station.address, late_ms=late_ms)
            else:
                self._wake_no_later_than(job.expires_at + 1e-3)
        error = error or job.permit_error(now)
        if error is None:
            return False
        lane.remove(job)
        self.rejected.append((job, error))
        return True

    def _stop_order(self, job: PreparedRequest) -> tuple[bool, bool, float]:
        """Least first; equals in the order in which they were asked for."""
        return (
            job.bus_request.priority is not RequestPriority.STOP,
            not job.is_broadcast,
            self._last_stop_at.get(job.station, 0.0),
        )

    def _next_background(self, polls: deque[PreparedRequest], now: float) -> PreparedRequest | None:
        fence = self._next_sync_probe(now) if self.untrusted_stations else None
        return fence or self._next_poll(polls, now)

    def _next_poll(self, retries: deque[PreparedRequest], now: float) -> PreparedRequest | None:
        if retries and (job := self._next_sendable(retries, now)):
            return job
        if not self.poll_schedule:
            return None
        if poll := self.poll_schedule.next_due(now):
            return poll
        due = self.poll_schedule.next_due_at()
        if due is not None:
            self._wake_no_later_than(due)
        return None

    def _next_sync_probe(self, now: float) -> PreparedRequest | None:
        """The fence that has been due longest: of a suspect station, or a probe of a silent one within the budget."""
        budget_at = self.probe_budget.allowed_at
        best: Station | None = None
        for station in self.untrusted_stations:
            at = station.sync_due_at(budget_at)
            if at > now:
                self._wake_no_later_than(at)
            elif best is None or _sync_due_since(station) < _sync_due_since(best):
                best = station
        return None if best is None else best.sync_probe(self._settings)

    def _wake_no_later_than(self, at: float) -> None:
        if at < self.next_wake_at:
            self.next_wake_at = at


def _sync_due_since(station: Station) -> float:
    return station.next_probe_at if station.dead else station.quarantined_until


def _is_command(job: PreparedRequest) -> bool:
    """Stops have a lane of their own, whatever they were asked in."""
    return job.priority is RequestPriority.COMMAND or job.effect is Effect.MOTION
