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

from drivebus.bus.job import Job
from drivebus.bus.planner import Plan, PollJob
from drivebus.bus.stations import ProbeBudget, Station
from drivebus.errors import Expired
from drivebus.message import Effect, Lane

if TYPE_CHECKING:
    from drivebus.line import LineSettings

FOREVER = float("inf")
URGENT_RUN = 4
POLL_RUN = 9


class Scheduler:
    """The queues of one bus. ``wake_at``: when the last ``next`` may answer differently without anything new."""

    __slots__ = (
        "_commands", "_line", "_polls", "_stopped", "_urgent", "budget", "doubted", "lanes", "plan", "refused",
        "wake_at",
    )  # fmt: skip

    def __init__(self, line: LineSettings) -> None:
        self._line = line
        self.lanes: tuple[deque[Job], ...] = tuple(deque() for _ in Lane)
        self.plan = Plan()
        self.budget = ProbeBudget()
        self.doubted: list[Station] = []
        """Stations that owe a fence: suspect or dead."""
        self.refused: list[tuple[Job, Exception]] = []
        self.wake_at = FOREVER
        self._commands = self._urgent = 0
        self._polls = 0
        self._stopped: dict[Station, float] = {}
        """When each station's last stop left."""

    def put(self, job: Job) -> None:
        self.lanes[job.lane].append(job)

    def again(self, job: Job) -> None:
        """One more attempt: first in its lane, but a stop lets the other drives' stops go first."""
        if job.lane is Lane.STOP:
            self.lanes[job.lane].append(job)
        else:
            self.lanes[job.lane].appendleft(job)

    def next(self, now: float) -> Job | None:
        """The frame that is to be sent next (its gap may still have to pass), or None.

        A stop that was asked for in another lane (the levels that follow a VC660's stop pulse) lets stops go first.
        """
        self.wake_at = FOREVER
        stops, commands, parameters, polls, probes = self.lanes
        if stops:
            return min(stops, key=self._stop_turn)
        if self._urgent >= URGENT_RUN and (job := self._others_turn(polls, now)):
            return job
        for lane in (parameters, commands) if self._commands >= URGENT_RUN else (commands, parameters):
            if lane and (job := self._first(lane, now)):
                return job
        if self.doubted and (job := self._fence(now)):
            return job
        if probes and self._polls >= POLL_RUN and (job := self._first(probes, now)):
            return job
        if job := self._poll(polls, now):
            return job
        return self._first(probes, now) if probes else None

    def took(self, job: Job, now: float) -> None:
        """``job`` is being sent."""
        if job.fence:
            job.station.fence_waiting = None
        elif isinstance(job, PollJob) and not job.retrying:
            self.plan.took(job, now)
        else:
            if isinstance(job, PollJob):
                job.retrying = False
            self.lanes[job.lane].remove(job)
        lane = job.lane
        if lane is Lane.STOP and not job.broadcast:
            self._stopped[job.station] = now
        self._urgent = self._urgent + 1 if lane is Lane.PARAMETER or lane is Lane.COMMAND else 0
        if lane is Lane.PARAMETER:
            self._commands = 0
        elif lane is Lane.COMMAND and self.lanes[Lane.PARAMETER]:
            self._commands += 1
        self._polls = self._polls + 1 if lane is Lane.POLL else 0

    def withdraw(self, unwanted: Callable[[Job], bool]) -> list[Job]:
        """Take jobs out of the queues (not out of the plan)."""
        gone: list[Job] = []
        for lane in self.lanes:
            found = [job for job in lane if unwanted(job)]
            for job in found:
                lane.remove(job)
                if isinstance(job, PollJob):
                    job.retrying = False
            gone += found
        return gone

    def supersede(self, stations: Iterable[Station]) -> list[Job]:
        """A stop for these stations: their queued commands go, and every older permit is void (6.5)."""
        stopped = set(stations)
        for station in stopped:
            station.generation += 1
        return self.withdraw(lambda job: job.station in stopped and _is_command(job))

    def forget(self, station: Station) -> None:
        """The station is no longer of this bus."""
        self.plan.cancel(lambda job: job.station is station)
        self._stopped.pop(station, None)
        station.parked.clear()
        if station in self.doubted:
            self.doubted.remove(station)

    def doubts(self, station: Station) -> None:
        if station not in self.doubted:
            self.doubted.append(station)

    def trusts(self, station: Station, now: float) -> None:
        if station in self.doubted:
            self.doubted.remove(station)
        self.plan.resume(station, now)

    def __len__(self) -> int:
        return sum(len(lane) for lane in self.lanes)

    def _first(self, lane: deque[Job], now: float) -> Job | None:
        """The first of a lane that may be sent; a suspect station's fence goes in its place."""
        head = lane[0]
        if not head.station.suspect and head.expires_at is None and head.permit is None and head.refusal(now) is None:
            return head
        for job in tuple(lane):
            if self._stale(lane, job, now):
                continue
            station = job.station
            if not station.suspect:
                return job
            if now >= station.quarantined_until:
                return station.fence_job(self._line)
            self._wake(station.quarantined_until)
        return None

    def _stale(self, lane: deque[Job], job: Job, now: float) -> bool:
        """Refuse what is too old (ruling 12) or has lost its permit (I1); nothing is sent of it."""
        error: Exception | None = None
        if job.expires_at is not None:
            if now > job.expires_at:
                late_ms = round((now - job.expires_at) * 1000)
                error = Expired("bus.expired", station=job.station.address, late_ms=late_ms)
            else:
                self._wake(job.expires_at + 1e-3)
        error = error or job.refusal(now)
        if error is None:
            return False
        lane.remove(job)
        self.refused.append((job, error))
        return True

    def _stop_turn(self, job: Job) -> tuple[bool, bool, float]:
        """Least first; equals in the order in which they were asked for."""
        return job.ask.lane is not Lane.STOP, not job.broadcast, self._stopped.get(job.station, 0.0)

    def _others_turn(self, polls: deque[Job], now: float) -> Job | None:
        fence = self._fence(now) if self.doubted else None
        return fence or self._poll(polls, now)

    def _poll(self, retries: deque[Job], now: float) -> Job | None:
        if retries and (job := self._first(retries, now)):
            return job
        if not self.plan:
            return None
        if poll := self.plan.first(now):
            return poll
        due = self.plan.next_due()
        if due is not None:
            self._wake(due)
        return None

    def _fence(self, now: float) -> Job | None:
        """The fence that has been due longest: of a suspect station, or a probe of a silent one within the budget."""
        budget_at = self.budget.allowed_at
        best: Station | None = None
        for station in self.doubted:
            at = station.fence_at(budget_at)
            if at > now:
                self._wake(at)
            elif best is None or _since(station) < _since(best):
                best = station
        return None if best is None else best.fence_job(self._line)

    def _wake(self, at: float) -> None:
        if at < self.wake_at:
            self.wake_at = at


def _since(station: Station) -> float:
    return station.probe_at if station.dead else station.quarantined_until


def _is_command(job: Job) -> bool:
    """Stops have a lane of their own, whatever they were asked in."""
    return job.lane is Lane.COMMAND or job.effect is Effect.MOTION
