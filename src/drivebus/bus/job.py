"""An ask made ready for the wire: its bytes, its times and its rights, computed once. Pure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from drivebus.errors import NotPermitted
from drivebus.message import Ask, Codec, Effect, Lane, Permit, WriteClass

if TYPE_CHECKING:
    from drivebus.bus.stations import Station
    from drivebus.line import LineSettings

ATTEMPTS = {WriteClass.READ: 2, WriteClass.ABSOLUTE: 3}
"""A read is retried once, an absolute write resent at most twice, everything else goes once (6.4, 6.5)."""


class Job:
    """One frame that somebody wants sent. ``token`` is whoever waits for the answer; None: the bus itself (fences)."""

    __slots__ = (
        "adapter_s", "ask", "attempts", "attempts_allowed", "broadcast", "codec", "data", "effect", "expires_at",
        "fence", "gap_s", "lane", "permit", "reply_bytes", "request", "send_s", "station",
        "token", "wait_s",
    )  # fmt: skip

    def __init__(self, ask: Ask, token: Any, station: Station, line: LineSettings, *, fence: bool = False) -> None:
        codec, request, timing = station.codec, ask.request, station.link.timing
        self.ask = ask
        self.token = token
        self.station = station
        self.codec: Codec = codec
        self.request = request
        self.data = codec.encode_request(request)
        self.reply_bytes = codec.reply_size(request)
        self.broadcast = self.reply_bytes == 0
        self.effect = station.link.effect(self.data)
        self.permit: Permit | None = ask.permit
        self.lane = lane_of(ask, self.effect)
        self.expires_at = None if self.effect is Effect.STOP else ask.expires_at
        self.fence = fence
        self.gap_s = station.gap_s
        self.adapter_s = timing.adapter_s
        self.send_s = line.seconds(len(self.data))
        if self.broadcast:
            self.wait_s = timing.turnaround_s
        else:
            self.wait_s = timing.timeout_s(line, codec.largest_reply(request))
        self.attempts = 0
        self.attempts_allowed = self._attempts_allowed()

    def _attempts_allowed(self) -> int:
        """The permit's class counts for a frame that acts: nobody can call a start absolute (F16)."""
        if self.broadcast or self.fence:
            return 1
        if self.effect is Effect.NONE:
            return ATTEMPTS[WriteClass.READ]
        if self.effect is Effect.STOP:
            return ATTEMPTS[WriteClass.ABSOLUTE]
        declared = self.ask.write_class if self.permit is None else self.permit.write_class
        return ATTEMPTS[WriteClass.ABSOLUTE] if declared is WriteClass.ABSOLUTE else 1

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


def lane_of(ask: Ask, effect: Effect) -> Lane:
    """A stop is a stop in whatever lane it was asked for (I3), and nothing else uses the stop lane."""
    if effect is Effect.STOP:
        return Lane.STOP
    return max(ask.lane, Lane.COMMAND)
