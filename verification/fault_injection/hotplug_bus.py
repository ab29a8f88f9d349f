"""Polled drives behind an adapter that can be pulled: what a campaign sees of them, and what is open."""

from __future__ import annotations

from typing import Any

from drivebus.values import Quality
from verification.campaign import CampaignRun
from verification.drive_variants import DriveVariant
from verification.fault_injection.usb_adapter import UsbAdapter, UsbHost
from verification.reference.request_effects import RequestEffect, classify_request
from verification.scenario.scenario import Scenario

HOTPLUG_LINE_QUALITIES = ("bytes", "clean", "bytes", "batch=16")
HOTPLUG_ADDRESSES = range(1, 4)
HOTPLUG_SETTLING_S = 2.0
"""Until every drive was polled for the first time."""


class HotplugBus:
    """One line, whose bus finds its adapter by the adapter's identity."""

    def __init__(self, session: CampaignRun, kind: DriveVariant, number: int) -> None:
        self.session, self.kind, self.rng = session, kind, session.rng(number)
        machine = UsbHost(session.rng("machine", number), "FT4ZK1X9" if number % 3 else None)
        self.adapter: Any = None
        self.scenario = Scenario(
            session,
            kind,
            HOTPLUG_ADDRESSES,
            name=f"{kind.name}/{number}",
            line_quality=HOTPLUG_LINE_QUALITIES[number % len(HOTPLUG_LINE_QUALITIES)],
            seed=number,
            around=lambda port: self._attach_adapter(port, machine),
        )
        for address in HOTPLUG_ADDRESSES:
            self.scenario.monitor(address)
        self.requests: list[tuple[float, RequestEffect]] = []
        self._observe_wire()
        self.scenario.run(HOTPLUG_SETTLING_S)
        self.initial_handles = self._open_handles()

    def _attach_adapter(self, port: Any, machine: UsbHost) -> UsbAdapter:
        adapter = self.adapter = UsbAdapter(port, machine)
        return adapter

    def _observe_wire(self) -> None:
        wire: Any = self.scenario.bench.wire
        say = wire.transmit

        def on_say(talker: Any, data: bytes, *more: Any, **named: Any) -> Any:
            text = say(talker, data, *more, **named)
            if hasattr(talker, "receive"):
                self.requests.append((text.start, classify_request(self.kind.model, self.kind.encoding, data)[1]))
            return text

        wire.transmit = on_say

    @property
    def now(self) -> float:
        return self.scenario.loop.time()

    def violation(self, text: str) -> None:
        self.scenario.oracle.violation(text)

    def phase(self) -> str:
        flight = self.scenario.bus.core.transaction
        if flight is None:
            return "idle or in a gap"
        if self.now < flight.tx_end_at:
            return "sending"
        return "hearing a reply" if flight.received_count else "waiting for a reply"

    def newest_reading_at(self, address: int) -> float:
        """When the newest value came that is not bad (DF800 publishes no scales: its values are uncertain)."""
        readings = self.scenario.monitors[address].status().readings.values()
        return max((one.source_time or 0.0 for one in readings if one.quality is not Quality.BAD), default=0.0)

    def _open_handles(self) -> dict[str, int]:
        """What is open, running or waiting."""
        loop, drives = self.scenario.loop, self.scenario.drives.values()
        return {
            "ports": self.adapter.opened - self.adapter.closed,
            "hosts": len(self.scenario.bench.masters),
            "tasks": len(loop.tasks) - sum(drive.stop_pending for drive in drives),
            "queued": len(self.scenario.bus.core.scheduler),
            "polls": len(self.scenario.bus.core.scheduler.poll_schedule),
        }

    def check_handles(self) -> None:
        """As many as before the first unplug."""
        found = self._open_handles()
        for what, count in self.initial_handles.items():
            if what != "queued" and found[what] != count:
                self.violation(f"G09 {found[what]} {what} after a replug, {count} before")
