"""Checks of the campaign ``late``: a baseline host, a log of all replies, and a counter of their lateness."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Sequence
from typing import Any

from verification.drive_variants import DriveVariant
from verification.scenario.scenario import Scenario

# --- baseline host ----------------------------------------------------------------------------------------------------

BASELINE_TIMEOUT_S = 0.1
BASELINE_GAP_CHARACTERS = 6


def is_plausible_reply(variant: DriveVariant, request: bytes, reply: bytes) -> bool:
    """Return whether the baseline host accepts these bytes as the reply."""
    size, places = variant.plain_reply
    return len(reply) == size and all(reply[place] == request[place] for place in places)


class BaselineHost:
    """Host that flushes, sends, and accepts the first frame with the right length, address and function, as many
    programs do.

    It replaces the bus on a campaign's line and must accept wrong replies there; otherwise the campaign proves nothing.
    ``on_accepted(address, sent_at, now, data)`` is called with each accepted reply.
    """

    def __init__(
        self,
        variant: DriveVariant,
        port: Any,
        loop: Any,
        reads: Sequence[tuple[int, bytes]],
        on_accepted: Callable[[int, float, float, bytes], None],
    ) -> None:
        self.frames = 0
        self._variant, self._port, self._loop, self._reads, self._on_accepted = variant, port, loop, reads, on_accepted
        self._buffer = bytearray()
        self._waiting: Any = None
        self._sent_at = 0.0

    async def open(self) -> None:
        await self._port.open(self)
        self._send_next()

    def _send_next(self) -> None:
        self._address, self._request = self._reads[self.frames % len(self._reads)]
        self.frames += 1
        self._buffer.clear()
        self._sent_at = self._loop.time()
        self._waiting = self._loop.call_later(BASELINE_TIMEOUT_S + self._seconds(len(self._request)), self._end)
        self._port.write(self._request)

    def _seconds(self, characters: int) -> float:
        return float(self._port.simulated_bus.settings.seconds(characters))

    def data_received(self, data: bytes, line_errors: int = 0) -> None:
        """Handle received bytes."""
        self._buffer += data
        if (
            self._waiting is not None
            and not line_errors
            and is_plausible_reply(self._variant, self._request, bytes(self._buffer))
        ):
            self._on_accepted(self._address, self._sent_at, self._loop.time(), bytes(self._buffer))
            self._waiting.cancel()
            self._end()

    def port_lost(self, error: Exception) -> None:
        """Unused: this port is never lost."""

    def _end(self) -> None:
        self._waiting = None
        self._loop.call_later(self._seconds(BASELINE_GAP_CHARACTERS), self._send_next)


# --- reply log --------------------------------------------------------------------------------------------------------

MAX_LOGGED_REPLIES = 1000
REPLY_LOG_S = 2.0


class ReplyLog:
    """Log of every station's replies and their times.

    Before each reply the station gets new values, so that no two replies are equal.
    """

    def __init__(self, simulated_bus: Any) -> None:
        self._counter = 0
        self._replies: dict[int, deque[tuple[float, bytes]]] = {}
        for station in simulated_bus.stations:
            self._observe(station, station.handle_frame)

    def _observe(self, station: Any, handle_frame: Any) -> None:
        replies = self._replies[station.address] = deque(maxlen=64)

        def on_handle_frame(message: Any, codec: Any, settings: Any, now: float, **named: Any) -> Any:
            station.advance(now)
            self._show_new_value(station.motor)
            reply = handle_frame(message, codec, settings, now, **named)
            if reply is not None:
                replies.append((now, reply.data))
            return reply

        station.handle_frame = on_handle_frame

    def _show_new_value(self, motor: Any) -> None:
        self._counter += 1
        motor.output_hz = motor.speed_hz = motor.current_a = self._counter % 3989 / 10
        motor.temperature_c = 1.0 + self._counter % 79

    def matches(self, address: int, sent_at: float, received_at: float, data: bytes) -> bool:
        """Return whether the station made exactly this reply between request and reception."""
        return self.replies_between(address, sent_at, received_at) == [data]

    def replies_between(self, address: int, sent_at: float, received_at: float) -> list[bytes]:
        """Return the replies that the station made between request and reception."""
        return [reply for at, reply in self._replies[address] if sent_at < at < received_at]


class LateReplyCounter:
    """Counter of replies by lateness and by what the bus did with them."""

    def __init__(self, scenario: Scenario, counts: Counter[str]) -> None:
        self._scenario, self._counts = scenario, counts
        self._late: dict[float, tuple[str, float]] = {}
        """End of a reply → its lateness class and the time it was made, of the last seconds."""
        self._collided_at = 0.0
        simulated_bus: Any = scenario.simulated_bus
        transmit_reply, deliver = simulated_bus.wire.transmit_reply, simulated_bus._deliver_to_masters

        def on_reply(source: Any, data: bytes, now: float, at: float) -> Any:
            reply = transmit_reply(source, data, now, at)
            name = self._lateness_class(reply.start - at)
            if len(self._late) >= MAX_LOGGED_REPLIES:
                self._late = {end: logged for end, logged in self._late.items() if end > now - REPLY_LOG_S}
            self._late[reply.end] = name, now
            counts[name] += 1
            return reply

        def on_deliver(reply: Any, first: int, last: int) -> None:
            if last == len(reply.data):
                self._on_delivered(reply)
            if isinstance(reply.data, bytearray):
                self._collided_at = reply.end
            deliver(reply, first, last)

        simulated_bus.wire.transmit_reply, simulated_bus._deliver_to_masters = on_reply, on_deliver

    def _lateness_class(self, late_s: float) -> str:
        if late_s < 1e-9:
            return "in time"
        return "late" if late_s <= self._scenario.variant.max_reply_lateness_s else "later than the longest lateness"

    def _on_delivered(self, transmission: Any) -> None:
        """Count a late reply that arrives during a newer transaction, and whether it has the form of its reply."""
        name, made_at = self._late.get(transmission.end, ("", 0.0))
        transaction = self._scenario.bus.core.transaction
        if not name or transaction is None or transaction.sent_at < made_at:
            return
        owner = "its own" if transaction.prepared.station.address == transmission.source.address else "another"
        self._counts[f"{name}, arrived during a newer request to {owner} station"] += 1
        if is_plausible_reply(self._scenario.variant, transaction.prepared.data, bytes(transmission.data)):
            self._counts[f"{name}, had the form of the reply to a newer request"] += 1

    def collided(self, received_at: float) -> bool:
        """Return whether the reply that ended at this time collided with another station's late reply."""
        return received_at == self._collided_at

    def on_accepted(self, received_at: float) -> None:
        """Count the acceptance of the reply that ended at this time."""
        name, _ = self._late.get(received_at, ("from nowhere", 0.0))
        self._counts[f"{name}, accepted"] += 1
