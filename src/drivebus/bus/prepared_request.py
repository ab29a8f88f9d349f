"""A request made ready for the wire: bytes, timing, priority and permit, all computed once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from drivebus.bus.messages import BusRequest, Permit, RequestPriority, RetryPolicy
from drivebus.bus.station import Station
from drivebus.bus.usual_delay import UsualDelay
from drivebus.errors import NotPermitted, ProtocolError
from drivebus.protocols.codec import Complete, DecodeResult, Effect, Incomplete
from drivebus.serial_settings import SerialSettings

# Read from its class, a member takes four times as long.
NO_EFFECT, MOTION_EFFECT, STOP_EFFECT = Effect.NONE, Effect.MOTION, Effect.STOP
STOP_PRIORITY, COMMAND_PRIORITY = RequestPriority.STOP, RequestPriority.COMMAND
READ_ATTEMPTS = 2  # a read is retried once
IDEMPOTENT_ATTEMPTS = 3  # an idempotent write is resent at most twice; every other frame is sent once


class PreparedRequest:
    """Frame to send. ``token`` identifies the receiver of the result; None for the sync probes of the bus itself."""

    __slots__ = (
        "attempts",
        "bus_request",
        "cacheable",
        "data",
        "effect",
        "expires_at",
        "gap_s",
        "is_broadcast",
        "is_sync_probe",
        "max_attempts",
        "permit",
        "priority",
        "reply_bytes",
        "reply_timeout_s",
        "request",
        "send_s",
        "sent_at",
        "station",
        "token",
        "usual_delay",
    )

    def __init__(
        self,
        bus_request: BusRequest,
        token: Any,
        station: Station,
        settings: SerialSettings,
        *,
        is_sync_probe: bool = False,
    ) -> None:
        """Raises ValueError for a field of the request out of range."""
        encoded = station.encode(bus_request.request, settings)
        self.bus_request = bus_request
        self.token = token
        self.station = station
        self.request = bus_request.request
        self.data = encoded.data
        self.effect = encoded.effect
        self.reply_bytes = encoded.reply_bytes
        self.send_s = encoded.send_s
        self.reply_timeout_s = encoded.reply_timeout_s
        self.cacheable = encoded.cacheable
        self.is_broadcast = encoded.reply_bytes == 0
        self.permit: Permit | None = bus_request.permit
        self.priority = priority_of(bus_request, self.effect)
        self.expires_at = None if self.effect is STOP_EFFECT else bus_request.expires_at
        self.is_sync_probe = is_sync_probe
        self.gap_s = station.gap_s
        self.usual_delay = station.usual_delay
        self.attempts = 0
        self.sent_at: float | None = None
        """Start of the last attempt."""
        reads = self.effect is NO_EFFECT and not is_sync_probe
        self.max_attempts = READ_ATTEMPTS if reads else self._max_write_attempts()

    def _max_write_attempts(self) -> int:
        """Return 1 for motion, so that the bus never repeats a start; for a setting the permit decides."""
        if self.is_broadcast or self.effect is MOTION_EFFECT:
            return 1
        if self.effect is STOP_EFFECT:
            return IDEMPOTENT_ATTEMPTS
        return IDEMPOTENT_ATTEMPTS if self.permit and self.permit.retry_policy is RetryPolicy.IDEMPOTENT else 1

    def decode_reply(self, data: bytes) -> DecodeResult:
        """Decode bytes as the reply to this request. Raises ProtocolError."""
        return self.station.codec.decode_reply(self.request, data)

    def is_mirrorable(self) -> bool:
        """Return whether the request's own bytes could pass for the beginning of its reply."""
        try:
            return not isinstance(self.station.codec.decode_reply(self.request, self.data), Incomplete)
        except ProtocolError:
            return False

    def permit_error(self, now: float) -> NotPermitted | None:
        """Return why this frame may not be sent now, None if it may. Reads and stops need no permit."""
        effect, station, permit = self.effect, self.station, self.permit
        if effect is NO_EFFECT or effect is STOP_EFFECT:
            return None
        address = station.address
        if permit is None:
            return NotPermitted("bus.no_permit", station=address, effect=effect.value)
        if permit.station != address or permit.effect is not effect:
            return NotPermitted(
                "bus.other_permit",
                station=address,
                effect=effect.value,
                granted=permit.station,
                granted_effect=permit.effect.value,
            )
        if now > permit.expires_at:
            return NotPermitted("bus.permit_expired", station=address, late_ms=round((now - permit.expires_at) * 1000))
        if permit.stop_epoch != station.stop_epoch:
            return NotPermitted("bus.permit_stopped", station=address)
        if effect is MOTION_EFFECT and station.start_inhibited:
            return NotPermitted("bus.start_inhibited", station=address)
        return None


def prepare(
    bus_request: BusRequest, token: Any, stations: Mapping[int, Station], settings: SerialSettings
) -> PreparedRequest | NotPermitted:
    """Encode a request, or return why it is not permitted. Raises ValueError for a field out of range.

    The address in the bytes must be the requested station: a permit for one drive can't move another.
    """
    station = stations.get(bus_request.station)
    if station is None:
        sender = next(
            (other for other in stations.values() if other.codec.broadcast_address == bus_request.station), None
        )
        if sender is None:
            return NotPermitted("bus.unregistered", station=bus_request.station)
        return _check_broadcast(PreparedRequest(bus_request, token, sender, settings), stations)
    prepared = PreparedRequest(bus_request, token, station, settings)
    if prepared.is_broadcast:
        return _check_broadcast(prepared, stations)
    if prepared.cacheable:
        return prepared
    addressed = station.codec.address_of(bus_request.request)
    if addressed != bus_request.station:
        return NotPermitted("bus.other_station", station=bus_request.station, found=addressed)
    return prepared


def _check_broadcast(prepared: PreparedRequest, stations: Mapping[int, Station]) -> PreparedRequest | NotPermitted:
    """Permit only a broadcast that is a stop to every station on the bus.

    The same command word may stop one model and start another (register 2000H of VC660 and DF800).
    """
    for station in stations.values():
        effect = station.config.effect_of(prepared.data)
        if effect is not STOP_EFFECT:
            return NotPermitted("bus.broadcast", station=station.address, effect=effect.value)
    if not prepared.is_broadcast:
        return NotPermitted("bus.broadcast_answered", station=prepared.bus_request.station)
    return prepared


def priority_of(bus_request: BusRequest, effect: Effect) -> RequestPriority:
    """Return the priority: a stop is a stop whatever was requested, and nothing else uses its priority."""
    if effect is STOP_EFFECT:
        return STOP_PRIORITY
    return COMMAND_PRIORITY if bus_request.priority is STOP_PRIORITY else bus_request.priority


@dataclass(frozen=True, slots=True)
class Poll:
    """A request to send periodically.

    ``period_s`` 0 means: as often as the bus allows. ``phase_s`` (from the start of polling) None: chosen so that the
    polls of a bus spread evenly.
    """

    request: Any
    period_s: float
    phase_s: float | None = None
    tag: Any = None

    def __post_init__(self) -> None:
        """Raises ValueError for a negative period."""
        if not self.period_s >= 0:
            raise ValueError(f"period {self.period_s} s: expected 0 or more")


class PreparedPoll(PreparedRequest):
    """A poll made ready for the wire; sent until it is cancelled."""

    __slots__ = (
        "_last_reply",
        "_last_result",
        "cancelled",
        "due_at",
        "period_s",
        "phase_at",
        "retry_queued",
    )

    def __init__(self, poll: Poll, token: Any, station: Station, settings: SerialSettings, phase_at: float) -> None:
        bus_request = BusRequest(
            station=station.address, request=poll.request, priority=RequestPriority.POLL, tag=poll.tag
        )
        super().__init__(bus_request, token, station, settings)
        self.period_s = poll.period_s
        self.phase_at = self.due_at = phase_at
        self.cancelled = False
        self.retry_queued = False
        """The second attempt waits in the queue: the poll is not due until that is done."""
        self.usual_delay = UsualDelay()
        self._last_reply = b""
        """Last whole reply, and its message below."""
        self._last_result: Complete | None = None

    def decode_reply(self, data: bytes) -> DecodeResult:
        """Decode as every request does, but only once where a drive at rest repeats its reply to the last bit."""
        if self._last_result is not None and data == self._last_reply:
            return self._last_result
        result = super().decode_reply(data)
        if type(result) is Complete:
            self._last_reply, self._last_result = data, result
        return result

    def skip_to(self, now: float) -> None:
        """Set the next due time after ``now``, in phase; missed polls are not made up for."""
        if self.period_s <= 0:
            self.due_at = now
            return
        self.due_at += self.period_s
        if self.due_at <= now:
            missed = int((now - self.phase_at) / self.period_s)
            self.due_at = self.phase_at + (missed + 1) * self.period_s
