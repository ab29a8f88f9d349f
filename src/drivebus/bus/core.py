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

from drivebus.bus import classify, failure
from drivebus.bus.commands import CoreCommand, DeliverResult, Send, SetTimer
from drivebus.bus.poll_schedule import Poll, PreparedPoll
from drivebus.bus.prepared_request import PreparedRequest
from drivebus.bus.scheduler import NEVER
from drivebus.bus.silence import SILENCE_TIMEOUT_S, SilenceTimeout
from drivebus.bus.state import BusState
from drivebus.bus.statistics import merge_counters
from drivebus.bus.trace import TraceEvent, TraceKind
from drivebus.bus.transaction import Transaction
from drivebus.bus.validation import validate_request
from drivebus.errors import LineError, NoReply, PortLost, Superseded
from drivebus.protocols.codec import BusRequest, BusResult, Effect, RequestPriority
from drivebus.serial_settings import SerialSettings

HOST_STALL_TOLERANCE_S = 0.2
"""Where the host itself was late to look (``woke`` did not come at the deadline), bytes may have come in time: they
are looked at up to so much later. It is still the one request outstanding; beyond, the value would be too old (I4)."""
TIMER_FIRED = -1.0
"""The last SetTimer has been served: the next one is said even if it is None again."""


class BusCore(BusState):
    """The bus itself: what is wanted of it, what happens to it, and what it does then."""

    _silent_since = 0.0
    _timer_at: float | None = None

    def __init__(self, settings: SerialSettings, **options: Any) -> None:
        """Options as ``BusState``: name, paced, echo, allow_mixed."""
        super().__init__(settings, **options)
        self._silence_timeout = SilenceTimeout(settings)

    # --- wishes ------------------------------------------------------------------------------------------------

    def submit(self, ask: BusRequest, token: Any, now: float) -> list[CoreCommand]:
        """Queue one transaction; its Done comes when it is over. Raises ValueError for a request out of range."""
        job = validate_request(ask, token, self.stations, self.settings)
        if not isinstance(job, PreparedRequest):
            return self._reject(ask, token, job)
        if not self.is_open:
            return self._reject(ask, token, PortLost("bus.not_open"))
        if job.effect is Effect.STOP:
            stopped = list(self.stations.values()) if job.is_broadcast else [job.station]
            for old in self.scheduler.supersede(stopped):
                self.complete(old, Superseded("bus.superseded", station=old.station.address))
        elif (refused := job.permit_error(now)) is not None:
            return self._reject(ask, token, refused)
        self.scheduler.enqueue(job)
        return self._advance(now)

    def cancel(self, token: Any, now: float) -> list[CoreCommand]:
        """Nobody waits for this any more: what has not been sent never will be, unless it is a stop (ruling 5)."""
        self._withdraw(token)
        return self._advance(now)

    def start_polling(self, address: int, polls: Sequence[Poll], token: Any, now: float) -> list[CoreCommand]:
        """Send these polls for ever; each answer is a Done under ``token``. Raises KeyError, ValueError."""
        station = self.stations[address]
        jobs = []
        for poll in polls:
            job = PreparedPoll(
                poll, token, station, self.settings, now + self.scheduler.poll_schedule.next_phase_s(poll)
            )
            if job.effect is not Effect.NONE:
                raise ValueError(f"poll {poll.request!r}: a poll only reads, this one is {job.effect.value}")
            jobs.append(job)
        for job in jobs:
            self.scheduler.poll_schedule.add(job)
        return self._advance(now)

    def stop_polling(self, token: Any, now: float) -> list[CoreCommand]:
        """No more of these polls, and no more Done under this token."""
        self.scheduler.poll_schedule.cancel_if(lambda job: job.token is token)
        for station in self.stations.values():
            station.suspended_polls = [job for job in station.suspended_polls if job.token is not token]
        self._withdraw(token)
        return self._advance(now)

    def _withdraw(self, token: Any) -> None:
        """Out of the queues; what is on the wire gets no second attempt. A stop is not taken back."""
        self.scheduler.remove_if(lambda job: job.token is token and job.effect is not Effect.STOP)
        if (
            self.transaction is not None
            and self.transaction.prepared.token is token
            and self.transaction.prepared.effect is not Effect.STOP
        ):
            self.transaction.prepared.max_attempts = 0
            if isinstance(self.transaction.prepared, PreparedPoll):
                self.transaction.prepared.cancelled = True

    def remove_station(self, address: int, now: float) -> list[CoreCommand]:
        """Forget a station: its polls end, what is queued for it fails."""
        station = self.stations.pop(address)
        station.stop_epoch += 1
        self.removed_stations[address] = station
        merge_counters(self.counters, station.counters)
        self.scheduler.remove_station(station)
        gone = self.scheduler.remove_if(lambda job: job.station is station)
        for job in gone:
            self.complete(job, NoReply("bus.removed", station=address))
        return self._advance(now)

    # --- events ------------------------------------------------------------------------------------------------

    def on_port_open(self, now: float) -> list[CoreCommand]:
        """The port is open (again). Nothing older is replayed (I10)."""
        self.is_open = True
        self.opened_at = now
        self.first_opened_at = now if self.first_opened_at is None else self.first_opened_at
        self._silent_since = max(now, self._silent_since)  # our last frame may still be leaving (I6)
        self.echo.reset()
        self.unsolicited.drain()
        for station in self.stations.values():
            station.probe_backoff_s = station.next_probe_at = 0.0
        return self._advance(now)

    def on_port_lost(self, error: PortLost, now: float) -> list[CoreCommand]:
        """The port is gone: everything pending fails, every station owes a fence, every permit is void."""
        self.is_open = False
        flight, self.transaction = self.transaction, None
        if flight is not None:
            self.record_bus_time(flight, now)
            self.complete(flight.prepared, error, flight)
        for job in self.scheduler.remove_if(lambda job: True):
            self.complete(job, error)
        for station in self.stations.values():
            station.stop_epoch += 1
            station.mark_suspect(now)
            self.scheduler.mark_suspect(station)
        self._silence_timeout.reset()
        return self._advance(now)

    def on_data(self, data: bytes, now: float, line_errors: int = 0) -> list[CoreCommand]:
        """Bytes came; ``marks`` of them with a parity or framing error (G20)."""
        self.counters.bytes_received += len(data)
        flight = self.transaction
        if line_errors:
            self.counters.count_event("marks", line_errors)
        if line_errors and flight is not None:
            flight.prepared.station.counters.count_event("marks", line_errors)
        if flight is not None and flight.message is None and now > flight.ends_at + HOST_STALL_TOLERANCE_S:
            self._finish_transaction(flight, now)
            flight = self.transaction
        if now > self._silent_since:
            self._silent_since = now
        if flight is not None:
            flight.on_data(data, now, line_errors)
        else:
            self.unsolicited.add(data, now)
        return self._advance(now)

    def on_timer(self, now: float) -> list[CoreCommand]:
        """It is ``now``: whatever was waited for may have come."""
        self._timer_at = TIMER_FIRED
        return self._advance(now)

    # --- the machine -------------------------------------------------------------------------------------------

    def _advance(self, now: float) -> list[CoreCommand]:
        flight = self.transaction
        if flight is not None and now >= flight.ends_at:
            self._finish_transaction(flight, now)
            flight = self.transaction
        if flight is not None:
            self._set_timer(flight.ends_at)
        elif self.is_open:
            self._send_next(now)
        else:
            self._set_timer(None)
        out, self.commands = self.commands, []
        return out

    def _send_next(self, now: float) -> None:
        """Choose, wait for the gap, transmit. The choice is made again at every wake, so a stop always comes first."""
        job = self.scheduler.next(now)
        while self.scheduler.rejected:
            refused, error = self.scheduler.rejected.pop(0)
            self.complete(refused, error)
        heard = self.unsolicited.buffer
        at = self._silent_since + (job.gap_s if job is not None else self._max_gap_s() if heard else 0.0)
        if job is not None and job.station.duplicate_reply_times and job.priority is not RequestPriority.STOP:
            at = max(at, job.station.next_allowed_at(now))
        if now < at and (job is None or not self._silence_timeout.expired(job, now)):
            self._set_timer(at if job is None else min(at, self._silence_timeout.deadline(job, now)))
            return
        if heard:
            classify.classify_idle(self, now)
            self._send_next(now)  # what was heard may have made a station suspect: choose again
        elif job is None:
            self._silence_timeout.reset()
            self._set_timer(None if self.scheduler.next_wake_at == NEVER else self.scheduler.next_wake_at)
        elif now < at and job.priority is not RequestPriority.STOP:
            self._fail_unsent(job, LineError("bus.no_silence", seconds=SILENCE_TIMEOUT_S), now)
        else:
            self._transmit(job, now)

    def _transmit(self, job: PreparedRequest, now: float) -> None:
        self.scheduler.on_sent(job, now)
        self._silence_timeout.reset()
        job.attempts += 1
        job.sent_at = now
        station = job.station
        station.last_request = job
        counters = station.counters
        counters.transactions += 1
        counters.bytes_sent += len(job.data)
        flight = Transaction(
            job, now, self.character_s, has_line_timing=self.has_line_timing, echo=self.echo.filter_for(job)
        )
        self.transaction = flight
        self._silent_since = station.last_request_sent_at = flight.tx_end_at
        self.commands.append(Send(job.data))
        if self.tracing:
            self.trace(TraceEvent(now, TraceKind.SENT, job.data, station.address, job.request, attempt=job.attempts))
        self._set_timer(flight.ends_at)

    def _finish_transaction(self, transaction: Transaction, now: float) -> None:
        """The transaction is over: believe its reply, or see what is wrong and go on from there."""
        self.transaction = None
        self.record_bus_time(transaction, now)
        if transaction.bytes_before_tx_end or transaction.foreign_frames:
            classify.count_extra(self, transaction, now)
        transaction.prepared.station.last_request_answered = (
            transaction.received_count >= transaction.prepared.reply_bytes
        )
        error = transaction.final_error()
        plain = (
            error is None
            and transaction.echo is None
            and self.echo.ruled_out
            and not transaction.prepared.station.suspect
        )
        if not plain:
            if error is None and not transaction.prepared.is_broadcast:
                error = failure.reject_reason(self, transaction)
            self.echo.observe(transaction)
        if error is None:
            self._accept_reply(transaction, now)
        else:
            failure.handle_failure(self, transaction, error, now)

    def _accept_reply(self, transaction: Transaction, now: float) -> None:
        job = transaction.prepared
        station = job.station
        if not job.is_broadcast:
            assert transaction.last_byte_at is not None
            station.last_reply_at = transaction.last_byte_at
            station.counters.record_reply(transaction.last_byte_at - transaction.tx_end_at, now)
            if job.is_sync_probe:
                self.trust_station(station, now, verified=True)
            station.seen = True
        if self.tracing and not job.is_broadcast:
            self.trace(
                TraceEvent(
                    transaction.last_byte_at or now,
                    TraceKind.REPLY,
                    bytes(transaction.buffer),
                    station.address,
                    transaction.message,
                )
            )
        self.complete(job, None, transaction)

    # --- small things ------------------------------------------------------------------------------------------

    def _reject(self, ask: BusRequest, token: Any, error: Exception) -> list[CoreCommand]:
        return [DeliverResult(token, BusResult(ask, error=error))]

    def _fail_unsent(self, job: PreparedRequest, error: Exception, now: float) -> None:
        """The line babbles: this frame is not sent, whoever waits is told, the next one gets its turn."""
        self.scheduler.on_sent(job, now)
        self._silence_timeout.reset()
        self.counters.count_event("no_silence")
        self.complete(job, error)
        if job.is_sync_probe:
            job.station.mark_suspect(now)
            for waiting in self.scheduler.remove_if(lambda other: other.station is job.station):
                self.complete(waiting, error)
        self._set_timer(now + job.gap_s)

    def _max_gap_s(self) -> float:
        return max((station.gap_s for station in self.stations.values()), default=3.5 * self.character_s)

    def _set_timer(self, when: float | None) -> None:
        if when != self._timer_at:
            self._timer_at = when
            self.commands.append(SetTimer(when))
