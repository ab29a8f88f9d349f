"""Polled drives behind an adapter that can be pulled: what a campaign sees of them, and what is open."""

from __future__ import annotations

from typing import Any

from drivebus.lab.breaking.adapter import Adapter, Machine
from drivebus.lab.campaign import Session
from drivebus.lab.kinds import Kind
from drivebus.lab.manual import Does, request
from drivebus.lab.world.stand import Stand
from drivebus.reading import Quality

WEATHERS = ("bytes", "clean", "bytes", "batch=16")
ADDRESSES = range(1, 4)
SETTLED_S = 2.0
"""Until every drive was polled for the first time."""


class Plugged:
    """One line, whose bus finds its adapter by the adapter's identity."""

    def __init__(self, session: Session, kind: Kind, number: int) -> None:
        self.session, self.kind, self.rng = session, kind, session.rng(number)
        machine = Machine(session.rng("machine", number), "FT4ZK1X9" if number % 3 else None)
        self.adapter: Any = None
        self.stand = Stand(
            session, kind, ADDRESSES, name=f"{kind.name}/{number}", weather=WEATHERS[number % len(WEATHERS)],
            seed=number, around=lambda port: self._plug(port, machine),
        )  # fmt: skip
        for address in ADDRESSES:
            self.stand.monitor(address)
        self.asked: list[tuple[float, Does]] = []
        self._tap()
        self.stand.run(SETTLED_S)
        self.sizes = self._sizes()

    def _plug(self, port: Any, machine: Machine) -> Adapter:
        adapter = self.adapter = Adapter(port, machine)
        return adapter

    def _tap(self) -> None:
        wire: Any = self.stand.bench.wire
        say = wire.say

        def on_say(talker: Any, data: bytes, *more: Any, **named: Any) -> Any:
            said = say(talker, data, *more, **named)
            if hasattr(talker, "hear"):
                self.asked.append((said.start, request(self.kind.model, self.kind.encoding, data)[1]))
            return said

        wire.say = on_say

    @property
    def now(self) -> float:
        return self.stand.loop.time()

    def violation(self, text: str) -> None:
        self.stand.witness.violation(text)

    def phase(self) -> str:
        flight = self.stand.bus.core.flight
        if flight is None:
            return "idle or in a gap"
        if self.now < flight.sent_end:
            return "sending"
        return "hearing a reply" if flight.heard else "waiting for a reply"

    def newest(self, address: int) -> float:
        """When the newest value came that is not bad (DF800 publishes no scales: its values are uncertain)."""
        readings = self.stand.monitors[address].status().readings.values()
        return max((one.source_time or 0.0 for one in readings if one.quality is not Quality.BAD), default=0.0)

    def _sizes(self) -> dict[str, int]:
        """What is open, running or waiting."""
        loop, drives = self.stand.loop, self.stand.drives.values()
        return {
            "ports": self.adapter.opened - self.adapter.closed,
            "hosts": len(self.stand.bench.hosts),
            "tasks": len(loop.tasks) - sum(drive.stop_pending for drive in drives),
            "queued": len(self.stand.bus.core.scheduler),
            "polls": len(self.stand.bus.core.scheduler.plan),
        }

    def check_handles(self) -> None:
        """As many as before the first unplug."""
        found = self._sizes()
        for what, count in self.sizes.items():
            if what != "queued" and found[what] != count:
                self.violation(f"G09 {found[what]} {what} after a replug, {count} before")
