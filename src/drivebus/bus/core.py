"""Engine of one bus without clock or I/O: events and ``now`` in, commands out, one request outstanding at any time.

Theory of operation
-------------------
Requests enter by ``submit`` (once) and ``start_polling`` (periodically) and wait in the ``Scheduler``. The port reports
``on_port_open``, ``on_port_lost`` and ``on_data``, the clock ``on_timer``. Each of these calls ends in ``_advance``:
it ends the open transaction when its time has come, sends the next frame when the bus has been silent for the gap, and
returns the commands to execute, in order: ``Send``, ``DeliverResult``, ``EmitTrace``. ``wake_at`` is the time at which
``on_timer`` is due.

A ``Transaction`` begins with our frame and ends when its reply has been followed by the gap of silence, or at its
deadline. A failed one makes its station suspect (see the table of states in ``station``): a late reply may be on its
way, so the station is left alone for a quarantine and must then answer a sync probe, a harmless request whose reply
can't be the late reply to an older request. Bytes outside a transaction are classified and counted, never applied
(``unsolicited``).

Safety argument
---------------
Which code decides that a frame may be sent:

1. Frames leave only in ``_send``, which only ``_send_next`` calls, with no transaction open.
2. ``_send_next`` calls it only after the gap of silence. Only a stop is sent without it, after its silence timeout.
3. The frame is the one that ``Scheduler.next`` chose at this very ``now``. It returns stops, sync probes, and requests
   of callers that it has just checked for expiry and by ``PreparedRequest.permit_error``: a write needs a permit for
   this station and this effect, not expired and of the current stop epoch, and a start inhibit refuses every motion
   (``drives.permissives`` grants no permit at all then). Polls and sync probes only read: ``start_polling`` and
   ``StationRegistry.add`` check that.
4. Effect and addressed station are decoded from the encoded bytes (``prepare``), not taken from the caller.
5. A stop needs no permit. ``submit`` queues it at once; it removes the commands that it overtakes and raises the stop
   epoch, which voids every permit granted before.

Which code decides that a reply is accepted:

6. ``Transaction`` takes only a complete frame that the codec decodes as the reply to the one open request, without a
   line error, apart from the echo of our own frame, and followed by the gap of silence. Where the port's timing is that
   of the bus (not over TCP or a pseudo-terminal), bytes received before the last bit of our own frame are no reply.
   A poll reuses the decoded message of its last reply for the same bytes (``PreparedPoll.decode_reply``); everything
   else here and below applies to each reply.
7. ``_reject_reason`` then rejects a reply that may be our own echo, and any reply of a suspect station except to a
   sync probe. It is skipped only where neither is possible: the echo is ruled out and the station is trusted.
   ``_accept_reply`` is the only place where a reply becomes a result.

Why no late reply can be credited to another request:

8. Every failed transaction whose reply may still come makes its station suspect before the next frame is chosen
   (``_handle_failure``), and so does the loss of the port. The only exception is a damaged reply: exactly as many bytes
   as the reply, with a checksum, character or line error, while no late reply is due on the bus: each station that was
   suspect in the last 5 s has answered a sync probe since, and no two drives share its address. Then it has come.
9. A suspect station gets only stops, whose replies are not accepted, until its quarantine has passed: the maximum
   reply lateness of its model (``[timing]`` of the profile).
10. The reply to another master's request could pass for one to ours. While it is due, only stops are sent. One that
    does not come, or that a stop does not wait for, makes its station suspect
    (``UnsolicitedBytes.end_foreign_request``), and so does a request whose last bytes came while we sent, because the
    adapter delivered it in two pieces.
11. The reply to its sync probe must not match any unanswered request of the last ``ANY_REPLY_LATENESS_S``
    (``_matches_older_request``). A station replies in order, so no older reply is on its way then.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from math import inf
from typing import Any

from drivebus.bus.commands import CoreCommand, DeliverResult, EmitTrace, Send
from drivebus.bus.echo import EchoDetector
from drivebus.bus.failure_reason import (
    copy_error,
    failure_reason,
    shows_a_reply,
)
from drivebus.bus.messages import BusRequest, BusResult
from drivebus.bus.prepared_request import (
    MOTION_EFFECT,
    NO_EFFECT,
    STOP_EFFECT,
    STOP_PRIORITY,
    Poll,
    PreparedPoll,
    PreparedRequest,
    prepare,
)
from drivebus.bus.scheduler import Scheduler
from drivebus.bus.silence_timeout import SILENCE_TIMEOUT_S, SilenceTimeout
from drivebus.bus.station import Presence, Station, StationHealth, StationState
from drivebus.bus.station_registry import StationRegistry
from drivebus.bus.statistics import BusStatistics, Counters, RecentActivity, bus_snapshot, merge_counters
from drivebus.bus.trace import TraceEvent, TraceKind
from drivebus.bus.transaction import Transaction
from drivebus.bus.unsolicited import UnsolicitedBytes
from drivebus.errors import (
    LineError,
    NoReply,
    PortLost,
    Superseded,
    TrailingError,
)
from drivebus.serial_settings import ANY_REPLY_LATENESS_S, SerialSettings

ONLINE = StationState.ONLINE  # a member read from its class takes longer
HOST_STALL_TOLERANCE_S = 0.2  # bytes read so late, because the host was busy, may have come in time: still decoded
SYNC_REJECTIONS_REQUIRED = 3  # error replies in a row that count as a sync: no station has so many late replies


class UntrustedReply(NoReply):
    """A reply came that may be our own echo or the reply to an older request. Sending again would not help."""

    retryable = False


class BusCore:
    """Engine of a bus and its stations. Methods with ``now`` (monotonic seconds) return the commands to execute."""

    def __init__(
        self,
        settings: SerialSettings,
        *,
        name: str = "",
        has_line_timing: bool = False,
        echo: str = "detect",
        allow_mixed: bool = False,
    ) -> None:
        """``has_line_timing``: the port delivers bytes at the time at which they were on the wire."""
        self.settings = settings
        self.name = name
        self.has_line_timing = has_line_timing
        self.learns_delays = False
        """Whether usual delays are learned: where bytes wait in the kernel until their reply is probably complete."""
        self.tracing = False
        self.is_open = False
        self._closed_by = PortLost("bus.not_open")  # why the port is not open
        self.first_opened_at: float | None = None
        """Start of all counters; a replug does not reset it."""
        self.opened_at = -inf
        """Last opening: start of the recent shares of bus time."""
        self.registry = StationRegistry(settings, allow_mixed=allow_mixed)
        self.stations = self.registry.stations
        self.scheduler = Scheduler(settings)
        self.echo = EchoDetector(echo)
        self.counters = Counters()
        """Counters of events that belong to no station."""
        self.unsolicited = UnsolicitedBytes(self.stations, self.scheduler, self.counters, settings)
        self.activity = RecentActivity()
        self.transaction: Transaction | None = None
        """The open transaction, at most one."""
        self.wake_at: float | None = None
        """Monotonic second at which ``on_timer`` is due, None if at none. Every event may change it."""
        self.character_s = settings.character_s
        self._silence_timeout = SilenceTimeout(settings)
        self._silent_since = 0.0
        self._commands: list[CoreCommand] = []

    # --- stations ------------------------------------------------------------------------------------------------

    def remove_station(self, address: int, now: float) -> list[CoreCommand]:
        """Remove a station: its polls end, its queued requests fail. Raises KeyError."""
        station = self.registry.remove(address)
        merge_counters(self.counters, station.counters)
        self.scheduler.remove_station(station)
        for prepared in self.scheduler.remove_if(lambda prepared: prepared.station is station):
            self._complete(prepared, NoReply("bus.removed", station=address))
        return self._advance(now)

    def presence(self, address: int) -> Presence:
        """Return whether a station replies. Raises KeyError for an address that is not registered."""
        presence = self.stations[address].state.presence
        return Presence.OFFLINE if presence is Presence.ONLINE and not self.is_open else presence

    def unusable_reply(self, address: int) -> Exception | None:
        """Return what a station that is not online sends in place of a reply, None for silence. Raises KeyError."""
        station = self.stations[address]
        return None if station.state.presence is Presence.ONLINE else station.unusable_reply

    def health(self, address: int, now: float) -> StationHealth:
        """Return presence, error rates and suspicions of a station. Raises KeyError: address not registered."""
        station = self.stations[address]
        return StationHealth(
            presence=self.presence(address),
            suspect=station.state.is_suspect,
            reads_wait_until=station.quarantined_until if station.state.is_suspect else 0.0,
            foreign_master=self.unsolicited.has_foreign_master(now),
            duplicate_address=station.has_duplicate_address(now),
            last_reply_at=station.last_reply_at,
            **station.counters.error_window.rates(now)._asdict(),
        )

    def statistics(self, now: float) -> BusStatistics:
        """Return counters, rates and shares since the bus was first opened."""
        return bus_snapshot(
            self.name,
            self.counters,
            self.activity,
            {address: station.counters for address, station in self.stations.items()},
            now=now,
            first_opened_at=now if self.first_opened_at is None else self.first_opened_at,
            opened_at=self.opened_at,
            queued=len(self.scheduler),
            echoes=self.echo.echo_count,
        )

    # --- requests ------------------------------------------------------------------------------------------------

    def submit(self, bus_request: BusRequest, token: Any, now: float) -> list[CoreCommand]:
        """Queue one transaction; its result comes as DeliverResult. Raises ValueError for a request out of range."""
        prepared = prepare(bus_request, token, self.stations, self.settings)
        if not isinstance(prepared, PreparedRequest):
            return self._reject(bus_request, token, prepared)
        if not self.is_open:
            return self._reject(bus_request, token, copy_error(self._closed_by))
        if prepared.effect is STOP_EFFECT:
            stopped = list(self.stations.values()) if prepared.is_broadcast else [prepared.station]
            for older in self.scheduler.supersede(stopped):
                self._complete(older, Superseded("bus.superseded", station=older.station.address))
        elif (error := prepared.permit_error(now)) is not None:
            return self._reject(bus_request, token, error)
        self.scheduler.enqueue(prepared)
        return self._advance(now)

    def cancel(self, token: Any, now: float) -> list[CoreCommand]:
        """Remove what has not been sent yet and prevent retries; a stop is not taken back."""
        self._withdraw(token)
        return self._advance(now)

    def withdraw_commands(self, address: int, error: Exception, now: float) -> list[CoreCommand]:
        """Fail the queued commands of a station with an error; one on the wire gets no further attempt."""
        station = self.stations[address]
        for prepared in self.scheduler.remove_commands((station,)):
            self._complete(prepared, copy_error(error))
        on_wire = None if self.transaction is None else self.transaction.prepared
        if on_wire is not None and on_wire.station is station and on_wire.permit is not None:
            on_wire.max_attempts = on_wire.attempts
        return self._advance(now)

    def start_polling(self, address: int, polls: Sequence[Poll], token: Any, now: float) -> list[CoreCommand]:
        """Send these polls until ``stop_polling``; each result is a DeliverResult. Raises KeyError, ValueError."""
        station = self.stations[address]
        schedule = self.scheduler.poll_schedule
        prepared_polls = []
        for poll in polls:
            prepared = PreparedPoll(poll, token, station, self.settings, now + schedule.next_phase_s(poll))
            if prepared.effect is not NO_EFFECT:
                raise ValueError(f"poll {poll.request!r}: a poll only reads, this one is {prepared.effect.value}")
            prepared_polls.append(prepared)
        for prepared in prepared_polls:
            schedule.add(prepared)
        return self._advance(now)

    def make_polls_due(self, token: Any, requests: Collection[Any], now: float) -> list[CoreCommand]:
        """Send these polls of a token next, each once; they wait for everything that goes before polls."""
        self.scheduler.poll_schedule.make_due(lambda poll: poll.token is token and poll.request in requests, now)
        return self._advance(now)

    def stop_polling(self, token: Any, now: float) -> list[CoreCommand]:
        """End the polls of this token; no further result is delivered for it."""
        self.scheduler.poll_schedule.cancel_if(lambda poll: poll.token is token)
        self._withdraw(token)
        return self._advance(now)

    def _withdraw(self, token: Any) -> None:
        """Remove requests from the queues; the one on the wire gets no further attempt. A stop stays."""
        self.scheduler.remove_if(lambda prepared: prepared.token is token and prepared.effect is not STOP_EFFECT)
        if self.transaction is None:
            return
        prepared = self.transaction.prepared
        if prepared.token is token and prepared.effect is not STOP_EFFECT:
            prepared.max_attempts = prepared.attempts

    def _reject(self, bus_request: BusRequest, token: Any, error: Exception) -> list[CoreCommand]:
        return [DeliverResult(token, BusResult(bus_request=bus_request, error=error))]

    # --- events --------------------------------------------------------------------------------------------------

    def on_port_open(self, now: float) -> list[CoreCommand]:
        """Handle the opening of the port. No older request is sent again."""
        self.is_open = True
        self.opened_at = now
        self.first_opened_at = now if self.first_opened_at is None else self.first_opened_at
        self._silent_since = max(now, self._silent_since)  # our last frame may still be on its way out
        self.echo.reset()
        self.unsolicited.reset()
        for station in self.stations.values():
            station.probe_backoff_s = station.next_probe_at = 0.0
        return self._advance(now)

    def on_port_lost(self, error: PortLost, now: float) -> list[CoreCommand]:
        """Handle the loss of the port: fail pending requests, void permits, require a sync probe of every station."""
        self.is_open, self._closed_by = False, error
        transaction, self.transaction = self.transaction, None
        if transaction is not None:
            self._record_bus_time(transaction, now)
            self._complete(transaction.prepared, copy_error(error), transaction)
        for prepared in self.scheduler.remove_if(lambda prepared: True):
            self._complete(prepared, copy_error(error))
        for station in self.stations.values():
            station.stop_epoch += 1
            station.contact_losses += 1
            station.failure_reason = station.earlier_failure_reason = station.unusable_reply = None
            self.scheduler.mark_suspect(station, now)
        self._silence_timeout.reset()
        return self._advance(now)

    def on_data(self, data: bytes, now: float, line_errors: int) -> list[CoreCommand]:
        """Handle received bytes, ``line_errors`` of them with a parity or framing error."""
        self.counters.bytes_received += len(data)
        transaction = self.transaction
        if line_errors:
            self.counters.count_event("line_errors", line_errors)
            if transaction is not None:
                transaction.prepared.station.counters.count_event("line_errors", line_errors)
        if (
            transaction is not None
            and transaction.message is None
            and now > transaction.ends_at + HOST_STALL_TOLERANCE_S
        ):
            self._finish_transaction(transaction, now)
            transaction = self.transaction
        if now > self._silent_since:
            self._silent_since = now
        if transaction is not None:
            transaction.on_data(data, now, line_errors)
        else:
            self.unsolicited.add(data, now)
        return self._advance(now)

    def on_timer(self, now: float) -> list[CoreCommand]:
        """Handle the time ``wake_at``."""
        return self._advance(now)

    # --- sending -------------------------------------------------------------------------------------------------

    def _advance(self, now: float) -> list[CoreCommand]:
        """End the open transaction when its time has come, send the next frame when it may be sent, set ``wake_at``."""
        transaction = self.transaction
        if transaction is not None and now >= transaction.ends_at:
            self._finish_transaction(transaction, now)
            transaction = self.transaction
        if transaction is not None:
            self.wake_at = transaction.ends_at
        elif self.is_open:
            self._send_next(now)
        else:
            self.wake_at = None
        commands, self._commands = self._commands, []
        return commands

    def _send_next(self, now: float) -> None:
        """Choose a frame, wait for the gap, send. Each wake-up chooses again, so a stop is always sent first."""
        foreign = self.unsolicited.foreign_request
        if foreign is not None and now >= foreign.reply_until and not self.unsolicited.buffer:
            self.unsolicited.end_foreign_request(now)
            foreign = None
        prepared = self.scheduler.next(now)
        while self.scheduler.rejected:
            rejected, error = self.scheduler.rejected.pop(0)
            self._complete(rejected, error)
        unsolicited = self.unsolicited.buffer
        if prepared is None and not unsolicited:
            self._silence_timeout.reset()
            self.wake_at = None if self.scheduler.next_wake_at == inf else self.scheduler.next_wake_at
            return
        at = self._silent_since + (self._max_gap_s() if prepared is None else prepared.gap_s)
        if prepared is not None and prepared.priority is not STOP_PRIORITY:
            if prepared.station.duplicate_reply_times:
                at = max(at, prepared.station.next_allowed_at(now))
            if foreign is not None and not unsolicited:
                at = max(at, foreign.reply_until)
        if now < at and (prepared is None or not self._silence_timeout.expired(prepared, now)):
            self.wake_at = at if prepared is None else min(at, self._silence_timeout.deadline(prepared, now))
            return
        if prepared is None or unsolicited:
            for event in self.unsolicited.classify_buffer(now):
                self.echo.record_repeat(event.data)
                self._trace(event)
            self._send_next(now)  # the bytes may have made a station suspect: choose again
        elif now < at and prepared.priority is not STOP_PRIORITY:
            self._fail_unsent(prepared, LineError("bus.no_silence", seconds=SILENCE_TIMEOUT_S), now)
        else:
            self._send(prepared, now)

    def _send(self, prepared: PreparedRequest, now: float) -> None:
        """Send a frame and open its transaction. The only place where a frame leaves."""
        if self.unsolicited.foreign_request is not None:
            self.unsolicited.end_foreign_request(now)
        self.scheduler.on_sent(prepared, now)
        self._silence_timeout.reset()
        prepared.attempts += 1
        prepared.sent_at = now
        station = prepared.station
        station.last_request = prepared.request
        station.motions_sent += prepared.effect is MOTION_EFFECT
        counters = station.counters
        counters.transactions += 1
        counters.bytes_sent += len(prepared.data)
        transaction = Transaction(
            prepared,
            now,
            self.character_s,
            has_line_timing=self.has_line_timing,
            echo=self.echo.filter_for(prepared),
        )
        self.transaction = transaction
        self._silent_since = station.last_request_sent_at = transaction.tx_end_at
        self._commands.append(Send(prepared.data))
        if self.tracing:
            self._trace(
                TraceEvent(
                    time=now,
                    kind=TraceKind.SENT,
                    data=prepared.data,
                    station=station.address,
                    message=prepared.request,
                    attempt=prepared.attempts,
                )
            )
        self.wake_at = transaction.ends_at

    def _fail_unsent(self, prepared: PreparedRequest, error: Exception, now: float) -> None:
        """Fail a frame because the bus is never silent; the next frame has its turn."""
        self.scheduler.on_sent(prepared, now)
        self._silence_timeout.reset()
        self.counters.count_event("no_silence")
        self._complete(prepared, error)
        if prepared.is_sync_probe:
            prepared.station.mark_suspect(now)
            self._fail_waiting(prepared.station, error)
        self.wake_at = now + prepared.gap_s

    def _max_gap_s(self) -> float:
        return max((station.gap_s for station in self.stations.values()), default=3.5 * self.character_s)

    # --- end of a transaction ------------------------------------------------------------------------------------

    def _finish_transaction(self, transaction: Transaction, now: float) -> None:
        """Accept the reply of a transaction, or handle its failure."""
        self.transaction = None
        self._record_bus_time(transaction, now)
        if transaction.bytes_before_tx_end or transaction.foreign_frames:
            self._record_extra_bytes(transaction, now)
        prepared = transaction.prepared
        station = prepared.station
        station.last_request_answered = transaction.received_count >= prepared.reply_bytes
        error = transaction.final_error()
        if error is not None or not self.echo.ruled_out or station.state.is_suspect:
            if error is None and not prepared.is_broadcast:
                error = self._reject_reason(transaction)
            self.echo.observe(transaction)
        if error is None:
            self._accept_reply(transaction, now)
        else:
            self._handle_failure(transaction, error, now)

    def _reject_reason(self, transaction: Transaction) -> Exception | None:
        """Return why a reply that the codec accepted must not be trusted, None if it may."""
        prepared = transaction.prepared
        station = prepared.station
        if not self.echo.accepts(transaction):
            return UntrustedReply("bus.own_echo", station=station.address)
        if station.state.is_suspect and not prepared.is_sync_probe:
            return UntrustedReply("bus.suspect", station=station.address)
        if not prepared.is_sync_probe:
            return None
        if transaction.message_size < prepared.reply_bytes:
            # An error reply repeats too little of its request to identify this sync probe (DF800: only the function).
            # Several in a row do, and a station that does not know the request must not stay offline for ever.
            too_few = station.sync_rejections < SYNC_REJECTIONS_REQUIRED - 1
            return UntrustedReply("bus.sync_rejected", station=station.address) if too_few else None
        if _matches_older_request(transaction):
            return UntrustedReply("bus.sync_ambiguous", station=station.address, seconds=ANY_REPLY_LATENESS_S)
        return None

    def _accept_reply(self, transaction: Transaction, now: float) -> None:
        """Deliver a trusted reply, or the end of a broadcast. The only place where a reply becomes a result."""
        prepared = transaction.prepared
        station = prepared.station
        if not prepared.is_broadcast:
            assert transaction.last_byte_at is not None
            station.record_reply_time(transaction.last_byte_at)
            station.last_frame = transaction.buffer
            station.unusable_reply = None
            station.counters.record_reply(transaction.last_byte_at - transaction.tx_end_at, now)
            if self.learns_delays:
                transaction.learn_delay()
            if prepared.is_sync_probe:
                self._mark_online(station, now, verified=True)
            elif station.state is not ONLINE:
                station.mark_replied()
            if self.tracing:
                self._trace(
                    TraceEvent(
                        time=transaction.last_byte_at,
                        kind=TraceKind.REPLY,
                        data=transaction.buffer,
                        station=station.address,
                        message=transaction.message,
                    )
                )
        self._complete(prepared, None, transaction)

    def _handle_failure(self, transaction: Transaction, error: Exception, now: float) -> None:
        """Handle a failed transaction: mark the station suspect, retry where allowed, or take it offline.

        Damage (a checksum or line error on exactly a reply's worth of bytes, with no late reply due on the bus) means
        that the reply has come: a read or an idempotent write may be repeated at once. After anything else it may
        still come.
        """
        prepared, station = transaction.prepared, transaction.prepared.station
        self._count_failure(transaction, error, now)
        reason = failure_reason(transaction, error)
        station.remember_unanswered(prepared.request, transaction.tx_end_at, now)
        self._trace(*self.unsolicited.detect_foreign_request(transaction, error, now))
        received = transaction.received_count > 0 or reason is not error
        if self.stations.get(station.address) is not station:  # removed meanwhile
            self._complete(prepared, error, transaction)
        elif isinstance(error, UntrustedReply):
            station.last_frame = transaction.buffer
            station.unusable_reply = error
            self._handle_untrusted_reply(prepared, error, now)
            self._complete(prepared, error, transaction)
        elif prepared.is_sync_probe:
            self._handle_sync_failure(transaction, reason if received else None, now)
        else:
            if not (transaction.is_damaged_reply(error) and self._no_late_reply_due(now)):
                station.failure_reason = reason if received else None
                self.scheduler.mark_suspect(station, now)
            if station.state.presence is Presence.NEVER_SEEN and isinstance(error, NoReply):
                station.mark_offline(now)
            if self._may_retry(prepared):
                self.counters.count_event("retry")
                self.scheduler.requeue(prepared)
            else:
                self._complete(prepared, reason, transaction)

    def _handle_untrusted_reply(self, prepared: PreparedRequest, error: UntrustedReply, now: float) -> None:
        station = prepared.station
        if error.key == "bus.sync_rejected":
            station.sync_rejections += 1
        elif error.key == "bus.sync_ambiguous":  # its own reply may still come
            station.quarantined_until = now + ANY_REPLY_LATENESS_S
            self._fail_waiting(station, error, quarantined=True)
        elif prepared.is_sync_probe:
            self._mark_online(station, now, verified=False)

    def _handle_sync_failure(self, transaction: Transaction, received: Exception | None, now: float) -> None:
        """Take the station offline and fail the requests that waited for its sync probe.

        ``received``: error that names the bytes in place of the reply; None where none came. Then the requests fail
        with the error of bytes that came since the sync probe before the last one; without such bytes, as offline.
        """
        station = transaction.prepared.station
        bytes_error = received or station.failure_reason or station.earlier_failure_reason
        error = bytes_error or NoReply("bus.offline", station=station.address)
        station.unusable_reply = bytes_error if shows_a_reply(bytes_error) else None
        station.earlier_failure_reason, station.failure_reason = station.failure_reason, None
        self.scheduler.mark_suspect(station, now)
        if station.state.is_unreachable:
            self.scheduler.probe_budget.spend(now - transaction.sent_at + station.gap_s, now)
        station.mark_offline(now)
        self._fail_waiting(station, error)

    def _fail_waiting(self, station: Station, error: Exception, *, quarantined: bool = False) -> None:
        """Fail the requests that wait for a sync probe of a station; a stop waits for none and stays queued.

        ``quarantined``: the next sync probe follows after 5 s, so only those fail that do not wait in a quarantine.
        """
        for waiting in self.scheduler.remove_if(
            lambda prepared: (
                prepared.station is station
                and prepared.priority is not STOP_PRIORITY
                and not (quarantined and prepared.bus_request.waits_in_quarantine)
            )
        ):
            self._complete(waiting, copy_error(error))

    def _may_retry(self, prepared: PreparedRequest) -> bool:
        """Return whether a request may be sent again; never to a station that is not online."""
        if prepared.attempts >= prepared.max_attempts or prepared.station.state.presence is not Presence.ONLINE:
            return False
        if isinstance(prepared, PreparedPoll):
            prepared.retry_queued = not prepared.cancelled
            return prepared.retry_queued
        return True

    def _no_late_reply_due(self, now: float) -> bool:
        """Return whether each suspicion of the last 5 s, of any station, was refuted by a sync probe."""
        return all(now - station.suspect_since > ANY_REPLY_LATENESS_S for station in self.stations.values())

    def _mark_online(self, station: Station, now: float, *, verified: bool) -> None:
        """End the quarantine of a station that has answered its sync probe."""
        station.failure_reason = station.earlier_failure_reason = None
        station.mark_online(verified=verified)
        self.scheduler.mark_trusted(station, now)

    # --- results and counters ------------------------------------------------------------------------------------

    def _complete(
        self, prepared: PreparedRequest, error: Exception | None, transaction: Transaction | None = None
    ) -> None:
        """Deliver the result of a request; sync probes have none."""
        if prepared.token is None:
            return
        if transaction is None:
            sent = prepared.data if prepared.attempts else b""  # a retry that is not sent does not undo the first one
            result = BusResult(
                bus_request=prepared.bus_request,
                error=error,
                sent=sent,
                sent_at=prepared.sent_at if sent else None,
                attempts=prepared.attempts,
            )
        else:
            result = transaction.result(error)
        if isinstance(prepared, PreparedPoll):
            prepared.attempts = 0
            if prepared.cancelled:
                return
        self._commands.append(DeliverResult(prepared.token, result))

    def _trace(self, *events: TraceEvent) -> None:
        if self.tracing:
            self._commands += map(EmitTrace, events)

    def _record_bus_time(self, transaction: Transaction, now: float) -> None:
        """Count the time of both frames on the wire, and the time for which the bus was occupied."""
        received = transaction.received_count + len(transaction.bytes_before_tx_end)
        counters = transaction.prepared.station.counters
        wire_s = transaction.prepared.send_s + received * self.character_s
        self.activity.append((now, wire_s, now - transaction.sent_at, counters))
        counters.bytes_received += transaction.received_count

    def _record_extra_bytes(self, transaction: Transaction, now: float) -> None:
        """Count the bytes of a transaction that do not belong to its reply."""
        early = transaction.bytes_before_tx_end
        if early:
            self.counters.count_event(TraceKind.BEFORE_TX_END.value, len(early))
            self._trace(TraceEvent(time=transaction.tx_end_at, kind=TraceKind.BEFORE_TX_END, data=early))
        self._trace(*self.unsolicited.record_foreign_frames(transaction, now))
        self._trace(*self.unsolicited.detect_overlapping_request(transaction, now))

    def _count_failure(self, transaction: Transaction, error: Exception, now: float) -> None:
        prepared, station = transaction.prepared, transaction.prepared.station
        name = type(error).__name__
        self.counters.errors[name] = self.counters.errors.get(name, 0) + 1
        station.counters.record_failure(error, now)
        if isinstance(error, LineError) and error.key != "bus.line_errors":  # those were counted as they came
            event = error.key.partition(".")[2]
            self.counters.count_event(event)
            station.counters.count_event(event)
        if isinstance(error, TrailingError) and transaction.ends_with_second_reply(error):
            self.counters.count_event("duplicate")
            station.counters.count_event("duplicate")
            station.record_duplicate_reply(now)
        if self.tracing:
            silent = isinstance(error, NoReply) and not transaction.received_count
            kind = TraceKind.NO_REPLY if silent else TraceKind.INVALID
            self._trace(
                TraceEvent(
                    time=now,
                    kind=kind,
                    data=transaction.buffer,
                    station=station.address,
                    message=None,
                    error=error,
                    attempt=prepared.attempts,
                )
            )


def _matches_older_request(transaction: Transaction) -> bool:
    """Return whether a sync reply could be the late reply to an older request as well.

    A nonce or an item distinguishes a sync reply from all others. Where only a register count does (DF800), an
    unanswered request of that count makes the sync probe worthless until its reply can no longer be on its way.
    """
    station = transaction.prepared.station
    return any(
        transaction.sent_at < entry.until and station.decode_reply_to(entry.request, transaction.buffer) is not None
        for entry in station.unanswered_requests
    )
