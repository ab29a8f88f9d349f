"""The bus as a machine without a clock: events and ``now`` in, effects out. One request outstanding, ever (I6).

Every public method that takes ``now`` returns the list of effects to perform, in order. The safety argument in one
place: a frame leaves only in ``_transmit``; ``_transmit`` runs only from ``_send_next``, with no transaction in flight,
after the gap, with the frame that ``Scheduler.next`` chose at this very ``now``, and the scheduler gives nothing but
stops, and frames whose permit and expiry it has just checked. A reply is believed only in ``_accept``, which a
transaction reaches only with a whole frame that its codec took for the answer to the one request outstanding,
followed by the gap in silence, from a station that owes no fence. What happens after a failure is in ``aftermath``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from drivebus.bus import aftermath, unasked
from drivebus.bus.babble import BABBLE_S, Patience
from drivebus.bus.effects import Act, Done, Transmit, WakeAt
from drivebus.bus.job import Job
from drivebus.bus.planner import Poll, PollJob
from drivebus.bus.rights import checked_job
from drivebus.bus.scheduler import FOREVER
from drivebus.bus.state import BusState
from drivebus.bus.statistics import retire
from drivebus.bus.trace import Kind, TraceEvent
from drivebus.bus.transaction import Transaction
from drivebus.errors import LineFault, NoReply, PortLost, Superseded
from drivebus.line import LineSettings
from drivebus.message import Answer, Ask, Effect, Lane

STALL_S = 0.2
"""Where the host itself was late to look (``woke`` did not come at the deadline), bytes may have come in time: they
are looked at up to so much later. It is still the one request outstanding; beyond, the value would be too old (I4)."""
SERVED = -1.0
"""The last WakeAt has been served: the next one is said even if it is None again."""


class BusCore(BusState):
    """The bus itself: what is wanted of it, what happens to it, and what it does then."""

    _quiet_since = 0.0
    _wake: float | None = None

    def __init__(self, line: LineSettings, **options: Any) -> None:
        """Options as ``BusState``: name, paced, echo, allow_mixed."""
        super().__init__(line, **options)
        self._patience = Patience(line)

    # --- wishes ------------------------------------------------------------------------------------------------

    def submit(self, ask: Ask, token: Any, now: float) -> list[Act]:
        """Queue one transaction; its Done comes when it is over. Raises ValueError for a request out of range."""
        job = checked_job(ask, token, self.stations, self.line)
        if not isinstance(job, Job):
            return self._refuse(ask, token, job)
        if not self.is_open:
            return self._refuse(ask, token, PortLost("bus.not_open"))
        if job.effect is Effect.STOP:
            stopped = list(self.stations.values()) if job.broadcast else [job.station]
            for old in self.scheduler.supersede(stopped):
                self.finish(old, Superseded("bus.superseded", station=old.station.address))
        elif (refused := job.refusal(now)) is not None:
            return self._refuse(ask, token, refused)
        self.scheduler.put(job)
        return self._go_on(now)

    def cancel(self, token: Any, now: float) -> list[Act]:
        """Nobody waits for this any more: what has not been sent never will be, unless it is a stop (ruling 5)."""
        self._drop(token)
        return self._go_on(now)

    def watch(self, address: int, polls: Sequence[Poll], token: Any, now: float) -> list[Act]:
        """Send these polls for ever; each answer is a Done under ``token``. Raises KeyError, ValueError."""
        station = self.stations[address]
        jobs = []
        for poll in polls:
            job = PollJob(poll, token, station, self.line, now + self.scheduler.plan.phase(poll))
            if job.effect is not Effect.NONE:
                raise ValueError(f"poll {poll.request!r}: a poll only reads, this one is {job.effect.value}")
            jobs.append(job)
        for job in jobs:
            self.scheduler.plan.put(job)
        return self._go_on(now)

    def unwatch(self, token: Any, now: float) -> list[Act]:
        """No more of these polls, and no more Done under this token."""
        self.scheduler.plan.cancel(lambda job: job.token is token)
        for station in self.stations.values():
            station.parked = [job for job in station.parked if job.token is not token]
        self._drop(token)
        return self._go_on(now)

    def _drop(self, token: Any) -> None:
        """Out of the queues; what is on the wire gets no second attempt. A stop is not taken back."""
        self.scheduler.withdraw(lambda job: job.token is token and job.effect is not Effect.STOP)
        if self.flight is not None and self.flight.job.token is token and self.flight.job.effect is not Effect.STOP:
            self.flight.job.attempts_allowed = 0
            if isinstance(self.flight.job, PollJob):
                self.flight.job.cancelled = True

    def remove(self, address: int, now: float) -> list[Act]:
        """Forget a station: its polls end, what is queued for it fails."""
        station = self.stations.pop(address)
        station.generation += 1
        self.gone[address] = station
        retire(self.counters, station.counters)
        self.scheduler.forget(station)
        gone = self.scheduler.withdraw(lambda job: job.station is station)
        for job in gone:
            self.finish(job, NoReply("bus.removed", station=address))
        return self._go_on(now)

    # --- events ------------------------------------------------------------------------------------------------

    def opened(self, now: float) -> list[Act]:
        """The port is open (again). Nothing older is replayed (I10)."""
        self.is_open = True
        self.opened_at = now
        self.begun_at = now if self.begun_at is None else self.begun_at
        self._quiet_since = max(now, self._quiet_since)  # our last frame may still be leaving (I6)
        self.echo.opened()
        self.listener.take()
        for station in self.stations.values():
            station.backoff_s = station.probe_at = 0.0
        return self._go_on(now)

    def lost(self, error: PortLost, now: float) -> list[Act]:
        """The port is gone: everything pending fails, every station owes a fence, every permit is void."""
        self.is_open = False
        flight, self.flight = self.flight, None
        if flight is not None:
            self.count(flight, now)
            self.finish(flight.job, error, flight)
        for job in self.scheduler.withdraw(lambda job: True):
            self.finish(job, error)
        for station in self.stations.values():
            station.generation += 1
            station.doubt(now)
            self.scheduler.doubts(station)
        self._patience.renew()
        return self._go_on(now)

    def received(self, data: bytes, now: float, marks: int = 0) -> list[Act]:
        """Bytes came; ``marks`` of them with a parity or framing error (G20)."""
        self.counters.bytes_received += len(data)
        flight = self.flight
        if marks:
            self.counters.kind("marks", marks)
        if marks and flight is not None:
            flight.job.station.counters.kind("marks", marks)
        if flight is not None and flight.message is None and now > flight.final_at + STALL_S:
            self._conclude(flight, now)
            flight = self.flight
        if now > self._quiet_since:
            self._quiet_since = now
        if flight is not None:
            flight.received(data, now, marks)
        else:
            self.listener.heard(data, now)
        return self._go_on(now)

    def woke(self, now: float) -> list[Act]:
        """It is ``now``: whatever was waited for may have come."""
        self._wake = SERVED
        return self._go_on(now)

    # --- the machine -------------------------------------------------------------------------------------------

    def _go_on(self, now: float) -> list[Act]:
        flight = self.flight
        if flight is not None and now >= flight.final_at:
            self._conclude(flight, now)
            flight = self.flight
        if flight is not None:
            self._sleep(flight.final_at)
        elif self.is_open:
            self._send_next(now)
        else:
            self._sleep(None)
        out, self.out = self.out, []
        return out

    def _send_next(self, now: float) -> None:
        """Choose, wait for the gap, transmit. The choice is made again at every wake, so a stop always comes first."""
        job = self.scheduler.next(now)
        while self.scheduler.refused:
            refused, error = self.scheduler.refused.pop(0)
            self.finish(refused, error)
        heard = self.listener.buffer
        at = self._quiet_since + (job.gap_s if job is not None else self._longest_gap_s() if heard else 0.0)
        if job is not None and job.station.second_answers and job.lane is not Lane.STOP:
            at = max(at, job.station.again_at(now))
        if now < at and (job is None or not self._patience.over(job, now)):
            self._sleep(at if job is None else min(at, self._patience.until(job, now)))
            return
        if heard:
            unasked.sort_out(self, now)
            self._send_next(now)  # what was heard may have made a station suspect: choose again
        elif job is None:
            self._patience.renew()
            self._sleep(None if self.scheduler.wake_at == FOREVER else self.scheduler.wake_at)
        elif now < at and job.lane is not Lane.STOP:
            self._fail_unsent(job, LineFault("bus.no_silence", seconds=BABBLE_S), now)
        else:
            self._transmit(job, now)

    def _transmit(self, job: Job, now: float) -> None:
        self.scheduler.took(job, now)
        self._patience.renew()
        job.attempts += 1
        job.sent_at = now
        station = job.station
        station.asked = job
        counters = station.counters
        counters.transactions += 1
        counters.bytes_sent += len(job.data)
        flight = Transaction(job, now, self.character_s, paced=self.paced, echo=self.echo.filter_for(job))
        self.flight = flight
        self._quiet_since = station.asked_at = flight.sent_end
        self.out.append(Transmit(job.data))
        if self.tracing:
            self.trace(TraceEvent(now, Kind.SENT, job.data, station.address, job.request, attempt=job.attempts))
        self._sleep(flight.final_at)

    def _conclude(self, flight: Transaction, now: float) -> None:
        """The transaction is over: believe its reply, or see what is wrong and go on from there."""
        self.flight = None
        self.count(flight, now)
        if flight.early or flight.foreign:
            unasked.during(self, flight, now)
        flight.job.station.answered = flight.heard >= flight.job.reply_bytes
        error = flight.outcome()
        plain = error is None and flight.echo is None and self.echo.proved and not flight.job.station.suspect
        if not plain:
            if error is None and not flight.job.broadcast:
                error = aftermath.disbelief(self, flight)
            self.echo.concluded(flight)
        if error is None:
            self._accept(flight, now)
        else:
            aftermath.failed(self, flight, error, now)

    def _accept(self, flight: Transaction, now: float) -> None:
        job = flight.job
        station = job.station
        if not job.broadcast:
            assert flight.heard_at is not None
            station.last_heard_at = flight.heard_at
            station.counters.replied(flight.heard_at - flight.sent_end, now)
            if job.fence:
                self.believe(station, now, really=True)
            station.seen = True
        if self.tracing and not job.broadcast:
            self.trace(
                TraceEvent(flight.heard_at or now, Kind.REPLY, bytes(flight.buffer), station.address, flight.message)
            )
        self.finish(job, None, flight)

    # --- small things ------------------------------------------------------------------------------------------

    def _refuse(self, ask: Ask, token: Any, error: Exception) -> list[Act]:
        return [Done(token, Answer(ask, error=error))]

    def _fail_unsent(self, job: Job, error: Exception, now: float) -> None:
        """The line babbles: this frame is not sent, whoever waits is told, the next one gets its turn."""
        self.scheduler.took(job, now)
        self._patience.renew()
        self.counters.kind("no_silence")
        self.finish(job, error)
        if job.fence:
            job.station.doubt(now)
            for waiting in self.scheduler.withdraw(lambda other: other.station is job.station):
                self.finish(waiting, error)
        self._sleep(now + job.gap_s)

    def _longest_gap_s(self) -> float:
        return max((station.gap_s for station in self.stations.values()), default=3.5 * self.character_s)

    def _sleep(self, when: float | None) -> None:
        if when != self._wake:
            self._wake = when
            self.out.append(WakeAt(when))
