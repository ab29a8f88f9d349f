"""The campaign ``replug`` finds no violation, follows its seed, and finds planted errors."""

from __future__ import annotations

import os
from typing import Any

import pytest

from drivebus.bus import Bus
from drivebus.bus.core import BusCore
from drivebus.ports import tty
from drivebus.ports.tty import SerialDescriptor
from fixtures.campaigns import finds
from verification.campaign import CampaignRun, load_campaign, run_campaign
from verification.campaigns import replug
from verification.families.modbus.facts import DF800, VC660
from verification.fault_injection.usb_adapter import reopen_ports


def test_another_seed_unplugs_at_other_times() -> None:
    first, second = (
        run_campaign(load_campaign("replug"), CampaignRun(campaign="replug", seed=seed, budget=4)) for seed in (1, 2)
    )
    assert first.violations == second.violations == [] and first.trials == second.trials == 4
    assert first.figures["names of the adapter"] != 1 and first.figures["real reopenings"]
    assert first.digest != second.digest


def test_a_drive_with_identical_sync_probes_returns_after_its_quarantine() -> None:
    """Seed 1, bus 10: the adapter was unplugged during a DF800's read of two registers."""
    campaign_run = CampaignRun(campaign="replug", seed=1, budget=1000)
    bus = replug.ReplugBus(campaign_run, DF800, 10)
    for _ in range(16):
        bus.unplug()
    bus.scenario.close()
    assert campaign_run.violations == []
    assert 5.0 < max(bus.back_s) < 7.0 and max(bus.first_s) < 1.0
    assert campaign_run.counts["every drive polled again: later than 2 s"] == 1


def test_a_bus_that_reopens_its_port_too_rarely_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivebus.bus.bus.REOPEN_INTERVAL_S", 2.5)
    assert finds("replug", "first polled again", 40)


def test_a_port_opened_by_its_name_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tty, "find_device", lambda path, identity: path)
    bus = replug.ReplugBus(CampaignRun(campaign="replug", seed=1, budget=1), VC660, 3)
    for _ in range(10):
        bus.unplug()
    assert any("opened the wrong adapter" in violation for violation in bus.campaign_run.violations)


def test_commands_queued_for_the_returning_port_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands wait in their queue until the port is back (I10)."""
    submit, opened = BusCore.submit, BusCore.on_port_open
    held_back: list[Any] = []

    def hold_back(self: BusCore, bus_request: Any, token: Any, now: float) -> Any:
        if self.is_open or bus_request.permit is None:
            return submit(self, bus_request, token, now)
        held_back.append((bus_request, token))
        return []

    def replay(self: BusCore, now: float) -> Any:
        commands = opened(self, now)
        for bus_request, token in held_back:
            commands += submit(self, bus_request, token, now)
        held_back.clear()
        return commands

    monkeypatch.setattr(BusCore, "submit", hold_back)
    monkeypatch.setattr(BusCore, "on_port_open", replay)
    lost = BusCore.on_port_lost

    def forgetful(self: BusCore, error: Any, now: float) -> Any:
        """Lose the port but keep permits and queues."""
        stop_epochs = {station: station.stop_epoch for station in self.stations.values()}
        queued = [job for lane in self.scheduler.queues for job in lane if job.permit is not None]
        for job in queued:
            self.scheduler.queues[job.priority].remove(job)
            held_back.append((job.bus_request, job.token))
        if self.transaction is not None and self.transaction.prepared.permit is not None:
            held_back.append((self.transaction.prepared.bus_request, object_future()))
        commands = lost(self, error, now)
        for station, stop_epoch in stop_epochs.items():
            station.stop_epoch = stop_epoch
        return commands

    monkeypatch.setattr(BusCore, "on_port_lost", forgetful)
    assert finds("replug", "I10", 60)


def object_future() -> Any:
    class FinishedFuture:
        def done(self) -> bool:
            return True

    return FinishedFuture()


def test_a_bus_that_does_not_detect_the_loss_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(BusCore, "on_port_lost", lambda self, error, now: [])
    bus = replug.ReplugBus(CampaignRun(campaign="replug", seed=1, budget=1), VC660, 3)
    bus._pull()
    assert any("has not detected it" in violation for violation in bus.campaign_run.violations)


def test_a_task_leaked_by_a_replug_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    opened = Bus._on_port_open

    def leaky(self: Bus) -> None:
        opened(self)
        if self._loop is not None and self.core.opened_at > 1.0:
            self._loop.create_task(forever(self._loop))

    async def forever(loop: Any) -> None:
        await loop.create_future()

    monkeypatch.setattr(Bus, "_on_port_open", leaky)
    assert finds("replug", "tasks after a replug", 2)


def test_a_descriptor_leaked_by_a_reopening_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    held_back: list[int] = []
    monkeypatch.setattr(SerialDescriptor, "close", lambda self: held_back.append(self.fd))
    found = reopen_ports(10)
    assert found["descriptors"] >= 10
    for fd in held_back:
        os.close(fd)
