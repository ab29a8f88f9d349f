"""The campaign of pulled adapters: clean, the same twice; and it finds what it is there to find."""

from __future__ import annotations

import os
from typing import Any

import pytest

from drivebus.bus import Bus
from drivebus.bus.core import BusCore
from drivebus.ports import tty
from drivebus.ports.tty import SerialDescriptor
from verification.campaign import CampaignRun, load_campaign, run_campaign
from verification.campaigns import replug
from verification.drive_variants import DF800, VC660
from verification.fault_injection import port_reopening


def violations(budget: int = 40) -> list[str]:
    return run_campaign(load_campaign("replug"), CampaignRun("replug", 1, budget)).violations


def test_the_first_unplugs_are_clean_and_the_same_twice() -> None:
    first, second = (run_campaign(load_campaign("replug"), CampaignRun("replug", 1, 60)) for _ in range(2))
    assert first.violations == [] and first.trials == 60
    assert first.digest == second.digest
    assert first.figures["names of the adapter"] != 1 and first.figures["real reopenings"]
    assert run_campaign(load_campaign("replug"), CampaignRun("replug", 2, 1)).digest != first.digest


def test_a_drive_whose_fences_are_alike_is_found_again_as_soon_as_none_can_be_late() -> None:
    """Seed 1, line 10: a DF800 was asked a question of two registers when the adapter was pulled."""
    session = CampaignRun("replug", 1, 1000)
    line = replug.ReplugBus(session, DF800, 10)
    for _ in range(16):
        line.unplug()
    line.scenario.close()
    assert session.violations == []
    assert 5.0 < max(line.back_s) < 7.0 and max(line.first_s) < 1.0
    assert session.counts["every drive polled again: later than 2 s"] == 1


def test_a_bus_that_looks_for_its_port_too_seldom_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivebus.bus.bus.REOPEN_INTERVAL_S", 2.5)
    assert any("G09 first polled again" in one for one in violations())


def test_a_port_that_is_opened_by_its_name_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tty, "find_device", lambda path, identity: path)
    line = replug.ReplugBus(CampaignRun("replug", 1, 1), VC660, 3)
    for _ in range(10):
        line.unplug()
    assert any("F12" in one for one in line.session.violations)


def test_what_is_kept_for_the_port_that_comes_back_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """I10: commands wait in their queue until the port is there again."""
    submit, opened = BusCore.submit, BusCore.on_port_open
    kept: list[Any] = []

    def keep(self: BusCore, ask: Any, token: Any, now: float) -> Any:
        if self.is_open or ask.permit is None:
            return submit(self, ask, token, now)
        kept.append((ask, token))
        return []

    def replay(self: BusCore, now: float) -> Any:
        acts = opened(self, now)
        for ask, token in kept:
            acts += submit(self, ask, token, now)
        kept.clear()
        return acts

    monkeypatch.setattr(BusCore, "submit", keep)
    monkeypatch.setattr(BusCore, "on_port_open", replay)
    lost = BusCore.on_port_lost

    def forgetful(self: BusCore, error: Any, now: float) -> Any:
        """Permits stay valid, and what is queued stays there."""
        generations = {station: station.stop_epoch for station in self.stations.values()}
        queued = [job for lane in self.scheduler.queues for job in lane if job.permit is not None]
        for job in queued:
            self.scheduler.queues[job.priority].remove(job)
            kept.append((job.bus_request, job.token))
        if self.transaction is not None and self.transaction.prepared.permit is not None:
            kept.append((self.transaction.prepared.bus_request, object_future()))
        acts = lost(self, error, now)
        for station, generation in generations.items():
            station.stop_epoch = generation
        return acts

    monkeypatch.setattr(BusCore, "on_port_lost", forgetful)
    assert any("I10" in one for one in violations(60))


def object_future() -> Any:
    class Nobody:
        def done(self) -> bool:
            return True

    return Nobody()


def test_a_bus_that_does_not_notice_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(BusCore, "on_port_lost", lambda self, error, now: [])
    line = replug.ReplugBus(CampaignRun("replug", 1, 1), VC660, 3)
    line._pull()
    assert any("has not noticed" in one for one in line.session.violations)


def test_a_task_that_every_replug_leaves_behind_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    opened = Bus._on_port_open

    def leaky(self: Bus) -> None:
        opened(self)
        if self._loop is not None and self.core.opened_at > 1.0:
            self._loop.create_task(forever(self._loop))

    async def forever(loop: Any) -> None:
        await loop.create_future()

    monkeypatch.setattr(Bus, "_on_port_open", leaky)
    assert any("tasks after a replug" in one for one in violations(2))


def test_a_descriptor_that_every_real_reopening_leaves_behind_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    kept: list[int] = []
    monkeypatch.setattr(SerialDescriptor, "close", lambda self: kept.append(self.fd))
    found = port_reopening.reopen_ports(10)
    assert found["descriptors"] >= 10
    for fd in kept:
        os.close(fd)
