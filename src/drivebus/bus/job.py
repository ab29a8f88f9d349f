"""An ask made ready for the wire: its bytes, its times and its rights, computed once. Pure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from drivebus.errors import NotPermitted
from drivebus.message import Ask, Codec, Effect, Lane, Permit, WriteClass

if TYPE_CHECKING:
    from drivebus.bus.stations import Station
    from drivebus.line import LineSettings

READ_ATTEMPTS = 2
ABSOLUTE_ATTEMPTS = 3
"""A read is retried once, an absolute write resent at most twice, everything else goes once (6.4, 6.5)."""


class Job:
    """One frame that somebody wants sent. ``token`` is whoever waits for the answer; None: the bus itself (fences)."""

    __slots__ = (
        "adapter_s", "ask", "attempts", "attempts_allowed", "broadcast", "codec", "data", "effect", "expires_at",
        "fence", "gap_s", "lane", "permit", "remembered", "reply_bytes", "request", "send_s", "sent_at", "station",
        "token", "wait_s",
    )  # fmt: skip

    def __init__(self, ask: Ask, token: Any, station: Station, line: LineSettings, *, fence: bool = False) -> None:
        self.ask = ask
        self.token = token
        self.station = station
        self.codec: Codec = station.codec
        self.request = ask.request
        self.data, self.effect, self.reply_bytes, self.send_s, self.wait_s, self.remembered = prepared(
            ask.request, station, line
        )
        self.broadcast = self.reply_bytes == 0
        self.permit: Permit | None = ask.permit
        self.lane = lane_of(ask, self.effect)
        self.expires_at = None if self.effect is Effect.STOP else ask.expires_at
        self.fence = fence
        self.gap_s = station.gap_s
        self.adapter_s = station.link.timing.adapter_s
        self.attempts = 0
        self.sent_at: float | None = None
        """When it left last."""
        self.attempts_allowed = READ_ATTEMPTS if self.effect is Effect.NONE and not fence else self._attempts_allowed()

    def _attempts_allowed(self) -> int:
        """What may move goes once; else the permit's class counts: nobody can call a start absolute (F16)."""
        if self.broadcast or self.effect is Effect.MOTION:
            return 1
        if self.effect is Effect.STOP:
            return ABSOLUTE_ATTEMPTS
        declared = self.ask.write_class if self.permit is None else self.permit.write_class
        return ABSOLUTE_ATTEMPTS if declared is WriteClass.ABSOLUTE else 1

    def refusal(self, now: float) -> NotPermitted | None:
        """Why this frame may not leave now. Reads and stops always may (rulings 5; I1)."""
        effect, station, permit = self.effect, self.station, self.permit
        if effect is Effect.NONE or effect is Effect.STOP:
            return None
        address = station.address
        if permit is None:
            return NotPermitted("bus.no_permit", station=address, effect=effect.value)
        if permit.station != address or permit.effect is not effect:
            return NotPermitted(
                "bus.other_permit", station=address, effect=effect.value, granted=permit.station,
                granted_effect=permit.effect.value,
            )  # fmt: skip
        if now > permit.expires_at:
            return NotPermitted("bus.permit_expired", station=address, late_ms=round((now - permit.expires_at) * 1000))
        if permit.generation != station.generation:
            return NotPermitted("bus.permit_stopped", station=address)
        if effect is Effect.MOTION and station.latched:
            return NotPermitted("bus.latched", station=address)
        return None


Prepared = tuple[bytes, Effect, int, float, float, bool]
"""Bytes, effect, bytes of the normal reply, seconds to send, seconds to wait after our last bit; and: is it a pure read
that speaks to this very station, so that it need not be looked at again?"""
REMEMBERED = 512
"""So many different reads of a station are kept prepared: a bus asks the same things again and again."""


def prepared(request: Any, station: Station, line: LineSettings) -> Prepared:
    """What the wire needs to know of a request. Only pure reads are remembered. Raises ValueError: out of range."""
    try:
        found = station.prepared.get(request)
    except TypeError:  # a request that can't be hashed
        return _prepare(request, station, line)
    if found is None:
        found = _prepare(request, station, line)
        if found[5]:
            if len(station.prepared) >= REMEMBERED:
                station.prepared.clear()
            station.prepared[request] = found
    return found


def _prepare(request: Any, station: Station, line: LineSettings) -> Prepared:
    codec, timing = station.codec, station.link.timing
    data = codec.encode_request(request)
    reply_bytes = codec.reply_size(request)
    wait_s = timing.timeout_s(line, codec.largest_reply(request)) if reply_bytes else timing.turnaround_s
    effect = station.link.effect(data)
    plain = effect is Effect.NONE and reply_bytes > 0 and codec.address_of(request) == station.address
    return data, effect, reply_bytes, line.seconds(len(data)), wait_s, plain


def lane_of(ask: Ask, effect: Effect) -> Lane:
    """A stop is a stop in whatever lane it was asked for (I3), and nothing else uses the stop lane."""
    if effect is Effect.STOP:
        return Lane.STOP
    return ask.lane or Lane.COMMAND
