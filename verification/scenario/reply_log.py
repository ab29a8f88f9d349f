"""What stations said, when they made it, how late it came, and what became of it: beside the witness, for ``late``."""

from __future__ import annotations

from collections import Counter, deque
from typing import Any

from verification.scenario.baseline_host import is_plausible_reply
from verification.scenario.scenario import Scenario

MAX_LOGGED_REPLIES = 1000
REPLY_LOG_S = 2.0


class ReplyLog:
    """What each station said, and when it made it. Before each reply it shows new values on all its monitors."""

    def __init__(self, bench: Any) -> None:
        self._counter = 0
        self._replies: dict[int, deque[tuple[float, bytes]]] = {}
        for station in bench.stations:
            self._watch(station, station.handle_frame)

    def _watch(self, station: Any, heard: Any) -> None:
        made = self._replies[station.address] = deque(maxlen=64)

        def on_heard(message: Any, codec: Any, line: Any, now: float, **named: Any) -> Any:
            station.advance(now)
            self._show_new_value(station.motor)
            text = heard(message, codec, line, now, **named)
            if text is not None:
                made.append((now, text.data))
            return text

        station.handle_frame = on_heard

    def _show_new_value(self, motor: Any) -> None:
        self._counter += 1
        motor.output_hz = motor.speed_hz = motor.current_a = self._counter % 3989 / 10
        motor.temperature_c = 1.0 + self._counter % 79

    def matches(self, address: int, sent_at: float, heard_at: float, data: bytes) -> bool:
        """Did this station make exactly this between the question and the answer?"""
        return self.replies_between(address, sent_at, heard_at) == [data]

    def replies_between(self, address: int, sent_at: float, heard_at: float) -> list[bytes]:
        """What this station made between the question and the answer."""
        return [text for at, text in self._replies[address] if sent_at < at < heard_at]


class LateReplyCounter:
    """Sorts what stations say by how late it came, and tells what became of it."""

    def __init__(self, stand: Scenario, counts: Counter[str]) -> None:
        self._stand, self._counts = stand, counts
        self._late: dict[float, tuple[str, float]] = {}
        """End of a reply → its class, and when it was made; of the last seconds."""
        self._collided_at = 0.0
        bench: Any = stand.bench
        reply, to_hosts = bench.wire.transmit_reply, bench._deliver_to_masters

        def on_reply(talker: Any, data: bytes, now: float, at: float) -> Any:
            text = reply(talker, data, now, at)
            name = self._lateness_class(text.start - at)
            if len(self._late) >= MAX_LOGGED_REPLIES:
                self._late = {end: one for end, one in self._late.items() if end > now - REPLY_LOG_S}
            self._late[text.end] = name, now
            counts[name] += 1
            return text

        def on_to_hosts(text: Any, first: int, last: int) -> None:
            if last == len(text.data):
                self._on_delivered(text)
            if isinstance(text.data, bytearray):
                self._collided_at = text.end
            to_hosts(text, first, last)

        bench.wire.transmit_reply, bench._deliver_to_masters = on_reply, on_to_hosts

    def _lateness_class(self, late_s: float) -> str:
        if late_s < 1e-9:
            return "in time"
        return "late" if late_s <= self._stand.kind.max_reply_lateness_s else "later than the longest lateness"

    def _on_delivered(self, said: Any) -> None:
        """It is there: did it meet a newer question, and would it have passed for its answer?"""
        name, made_at = self._late.get(said.end, ("", 0.0))
        flight = self._stand.bus.core.transaction
        if not name or flight is None or flight.sent_at < made_at:
            return
        whose = "its own" if flight.prepared.station.address == said.source.address else "another"
        self._counts[f"{name}, met a newer question to {whose} station"] += 1
        if is_plausible_reply(self._stand.kind, flight.prepared.data, bytes(said.data)):
            self._counts[f"{name}, had the form of the answer to a newer question"] += 1

    def collided(self, heard_at: float) -> bool:
        """What ended then was on the wire together with another station's late reply."""
        return heard_at == self._collided_at

    def on_accepted(self, heard_at: float) -> None:
        """The bus took what ended then for an answer."""
        name, _ = self._late.get(heard_at, ("from nowhere", 0.0))
        self._counts[f"{name}, believed"] += 1
