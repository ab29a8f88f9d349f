"""What stations said, when they made it, how late it came, and what became of it: beside the witness, for ``late``."""

from __future__ import annotations

from collections import Counter, deque
from typing import Any

from drivebus.lab.world.naive import fits
from drivebus.lab.world.stand import Stand

KEPT = 1000
KEPT_S = 2.0


class Maker:
    """What each station said, and when it made it. Before each reply it shows new values on all its monitors."""

    def __init__(self, bench: Any) -> None:
        self._turn = 0
        self._made: dict[int, deque[tuple[float, bytes]]] = {}
        for station in bench.stations:
            self._watch(station, station.heard)

    def _watch(self, station: Any, heard: Any) -> None:
        made = self._made[station.address] = deque(maxlen=64)

        def on_heard(message: Any, codec: Any, line: Any, now: float, **named: Any) -> Any:
            station.advance(now)
            self._show(station.motor)
            said = heard(message, codec, line, now, **named)
            if said is not None:
                made.append((now, said.data))
            return said

        station.heard = on_heard

    def _show(self, motor: Any) -> None:
        self._turn += 1
        motor.output_hz = motor.speed_hz = motor.current_a = self._turn % 3989 / 10
        motor.temperature_c = 1.0 + self._turn % 79

    def right(self, address: int, sent_at: float, heard_at: float, data: bytes) -> bool:
        """Did this station make exactly this between the question and the answer?"""
        return self.between(address, sent_at, heard_at) == [data]

    def between(self, address: int, sent_at: float, heard_at: float) -> list[bytes]:
        """What this station made between the question and the answer."""
        return [said for at, said in self._made[address] if sent_at < at < heard_at]


class Lateness:
    """Sorts what stations say by how late it came, and tells what became of it."""

    def __init__(self, stand: Stand, counts: Counter[str]) -> None:
        self._stand, self._counts = stand, counts
        self._late: dict[float, tuple[str, float]] = {}
        """End of a reply → its class, and when it was made; of the last seconds."""
        self._spoilt_at = 0.0
        bench: Any = stand.bench
        reply, to_hosts = bench.wire.reply, bench._to_hosts

        def on_reply(talker: Any, data: bytes, now: float, at: float) -> Any:
            said = reply(talker, data, now, at)
            name = self._class(said.start - at)
            if len(self._late) >= KEPT:
                self._late = {end: one for end, one in self._late.items() if end > now - KEPT_S}
            self._late[said.end] = name, now
            counts[name] += 1
            return said

        def on_to_hosts(said: Any, first: int, last: int) -> None:
            if last == len(said.data):
                self._delivered(said)
            if isinstance(said.data, bytearray):
                self._spoilt_at = said.end
            to_hosts(said, first, last)

        bench.wire.reply, bench._to_hosts = on_reply, on_to_hosts

    def _class(self, late_s: float) -> str:
        if late_s < 1e-9:
            return "in time"
        return "late" if late_s <= self._stand.kind.lateness_s else "later than the longest lateness"

    def _delivered(self, said: Any) -> None:
        """It is there: did it meet a newer question, and would it have passed for its answer?"""
        name, made_at = self._late.get(said.end, ("", 0.0))
        flight = self._stand.bus.core.flight
        if not name or flight is None or flight.sent_at < made_at:
            return
        whose = "its own" if flight.job.station.address == said.talker.address else "another"
        self._counts[f"{name}, met a newer question to {whose} station"] += 1
        if fits(self._stand.kind, flight.job.data, bytes(said.data)):
            self._counts[f"{name}, had the form of the answer to a newer question"] += 1

    def spoilt(self, heard_at: float) -> bool:
        """What ended then was on the wire together with another station's late reply."""
        return heard_at == self._spoilt_at

    def believed(self, heard_at: float) -> None:
        """The bus took what ended then for an answer."""
        name, _ = self._late.get(heard_at, ("from nowhere", 0.0))
        self._counts[f"{name}, believed"] += 1
