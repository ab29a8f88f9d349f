"""An ask made ready for the wire: its bytes, its times and its rights, computed once. Pure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from drivebus.errors import NotPermitted
from drivebus.protocols.codec import BusRequest, Codec, Effect, Permit, RequestPriority, RetryPolicy

if TYPE_CHECKING:
    from drivebus.bus.station import Station
    from drivebus.serial_settings import SerialSettings

READ_ATTEMPTS = 2
IDEMPOTENT_ATTEMPTS = 3
"""A read is retried once, an absolute write resent at most twice, everything else goes once (6.4, 6.5)."""


class PreparedRequest:
    """One frame that somebody wants sent. ``token`` is whoever waits for the answer; None: the bus itself (fences)."""

    __slots__ = (
        "adapter_latency_s",
        "attempts",
        "bus_request",
        "cacheable",
        "codec",
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
        self.bus_request = bus_request
        self.token = token
        self.station = station
        self.codec: Codec = station.codec
        self.request = bus_request.request
        self.data, self.effect, self.reply_bytes, self.send_s, self.reply_timeout_s, self.cacheable = encode_cached(
            bus_request.request, station, settings
        )
        self.is_broadcast = self.reply_bytes == 0
        self.permit: Permit | None = bus_request.permit
        self.priority = priority_of(bus_request, self.effect)
        self.expires_at = None if self.effect is Effect.STOP else bus_request.expires_at
        self.is_sync_probe = is_sync_probe
        self.gap_s = station.gap_s
        self.adapter_latency_s = station.config.timing.adapter_latency_s
        self.attempts = 0
        self.sent_at: float | None = None
        """When it left last."""
        self.max_attempts = (
            READ_ATTEMPTS if self.effect is Effect.NONE and not is_sync_probe else self._max_write_attempts()
        )

    def _max_write_attempts(self) -> int:
        """What may move goes once; else the permit's class counts: nobody can call a start absolute (F16)."""
        if self.is_broadcast or self.effect is Effect.MOTION:
            return 1
        if self.effect is Effect.STOP:
            return IDEMPOTENT_ATTEMPTS
        declared = self.bus_request.retry_policy if self.permit is None else self.permit.retry_policy
        return IDEMPOTENT_ATTEMPTS if declared is RetryPolicy.IDEMPOTENT else 1

    def permit_error(self, now: float) -> NotPermitted | None:
        """Why this frame may not leave now. Reads and stops always may (rulings 5; I1)."""
        effect, station, permit = self.effect, self.station, self.permit
        if effect is Effect.NONE or effect is Effect.STOP:
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
        if effect is Effect.MOTION and station.start_inhibited:
            return NotPermitted("bus.latched", station=address)
        return None


EncodedRequest = tuple[bytes, Effect, int, float, float, bool]
"""Bytes, effect, bytes of the normal reply, seconds to send, seconds to wait after our last bit; and: is it a pure read
that speaks to this very station, so that it need not be looked at again?"""
ENCODE_CACHE_SIZE = 512
"""So many different reads of a station are kept prepared: a bus asks the same things again and again."""


def encode_cached(request: Any, station: Station, settings: SerialSettings) -> EncodedRequest:
    """What the wire needs to know of a request. Only pure reads are remembered. Raises ValueError: out of range."""
    try:
        found = station.encode_cache.get(request)
    except TypeError:  # a request that can't be hashed
        return _encode(request, station, settings)
    if found is None:
        found = _encode(request, station, settings)
        if found[5]:
            if len(station.encode_cache) >= ENCODE_CACHE_SIZE:
                station.encode_cache.clear()
            station.encode_cache[request] = found
    return found


def _encode(request: Any, station: Station, settings: SerialSettings) -> EncodedRequest:
    codec, timing = station.codec, station.config.timing
    data = codec.encode_request(request)
    reply_bytes = codec.reply_size(request)
    wait_s = timing.timeout_s(settings, codec.largest_reply(request)) if reply_bytes else timing.turnaround_s
    effect = station.config.effect_of(data)
    plain = effect is Effect.NONE and reply_bytes > 0 and codec.address_of(request) == station.address
    return data, effect, reply_bytes, settings.seconds(len(data)), wait_s, plain


def priority_of(bus_request: BusRequest, effect: Effect) -> RequestPriority:
    """A stop is a stop in whatever lane it was asked for (I3), and nothing else uses the stop lane."""
    if effect is Effect.STOP:
        return RequestPriority.STOP
    return bus_request.priority or RequestPriority.COMMAND
