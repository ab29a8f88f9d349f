"""A plant that begins sends nothing but reads (I10); what it finds running is told, or stopped by policy."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Any

import pytest

from drivebus.bus.trace import TraceKind
from drivebus.drives import MemoryStore
from drivebus.drives.context import DriveLimits
from drivebus.protocols.codec import Effect
from drivebus.service.app import Service
from drivebus.service.config.model import BusConfig, InterlockConfig, OnRestart
from drivebus.simulator.motor import OutputPhase
from drivebus.simulator.port import find_simulated_bus
from drivebus.testing.virtual_time import run
from fixtures.service import BUSES, DRIVES, plant_config, running_service

SHARED = tuple(
    BusConfig(bus.id, f"{bus.link}&name=shared-{bus.id}") for bus in BUSES
)  # the same drives in every life of the service


def effects(service: Service) -> set[Effect]:
    """Of everything that was sent."""
    return {
        unit.drive.dialect.station_config.effect_of(seen.event.data)
        for unit in service.plant.drives.values()
        for seen in service.plant.bus_of(unit).frames
        if seen.event.kind is TraceKind.SENT and seen.event.station == unit.config.address
    }


@pytest.mark.parametrize("policy", list(OnRestart))
def test_a_drive_that_is_found_running_is_adopted_or_stopped_and_never_started(policy: OnRestart) -> None:
    """I10, ruling 7: a life before this one started it."""

    async def second_life() -> None:
        drives = tuple(replace(drive, on_restart=policy) for drive in DRIVES)
        chosen = plant_config(buses=SHARED, drives=drives)
        async with running_service(chosen) as first:
            await first.grant_waivers()
            await asyncio.sleep(5)
            await first.call("drive.run", drive="fan-1", frequency_hz=20.0)
            first.service.plant.drives[
                "fan-1"
            ].started_by_service = False  # a life that ends without its last word (kill -9)
            await first.service.stop()
            bench: Any = find_simulated_bus("shared-a")
            assert bench.station(1).motor.phase is not OutputPhase.OFF
            service = Service(chosen, replace(first.storage, settings=MemoryStore(), drives=MemoryStore()))
            async with service:
                await asyncio.sleep(8)
                kinds = {alarm.kind for alarm in service.plant.alarms.active() if alarm.cleared_ms is None}
                if policy is OnRestart.STOP:
                    assert effects(service) <= {Effect.NONE, Effect.STOP}
                    assert bench.station(1).motor.phase is OutputPhase.OFF
                    assert [e.what for e in first.trail.entries if e.who == "drivebus"] == ["drive.stop"]
                else:
                    assert effects(service) == {Effect.NONE}
                    assert bench.station(1).motor.phase is not OutputPhase.OFF
                    assert "running_at_start" in kinds

    run(second_life())


def test_a_start_up_sends_only_reads() -> None:
    """I10."""

    async def story() -> None:
        async with running_service() as kit:
            await asyncio.sleep(30)
            assert effects(kit.service) == {Effect.NONE}

    run(story())


def test_an_interlock_stops_what_turns_and_forbids_its_start() -> None:
    async def story() -> None:
        interlock = InterlockConfig("fan-first", ("pump-1",), "fan-1.output_frequency > 5 Hz")
        async with running_service(plant_config(interlocks=(interlock,))) as kit:
            await asyncio.sleep(15)
            await kit.grant_waivers()
            with pytest.raises(Exception, match="fan-first"):
                await kit.call("drive.run", drive="pump-1", frequency_hz=20.0)
            await kit.call("drive.run", drive="fan-1", frequency_hz=20.0)
            await asyncio.sleep(4)
            await kit.call("drive.run", drive="pump-1", frequency_hz=20.0)
            await kit.call("drive.stop", drive="fan-1")
            await asyncio.sleep(6)
            assert kit.station("pump-1").motor.phase is OutputPhase.OFF
            assert "drive.stop" in [entry.what for entry in kit.trail.entries if entry.who == "drivebus"]

    run(story())


def test_waivers_and_limits_outlive_the_process_and_never_reach_beyond_the_file() -> None:
    async def story() -> None:
        store = MemoryStore()
        async with running_service(store=store) as kit:
            await kit.grant_waivers("pump-1")
            await kit.call("drive.limits", drive="pump-1", minimum_hz=5.0, maximum_hz=40.0, reverse=False)
            with pytest.raises(Exception, match="limits of pump-1"):
                await kit.call("drive.limits", drive="pump-1", maximum_hz=900.0)
        async with running_service(store=store) as kit:
            view = await kit.call("drives.get", drive="pump-1")
            assert view["comm_loss"]["waiver"] == "test bench (tester)"
            assert (view["minimum_hz"], view["maximum_hz"], view["directions"]) == (5.0, 40.0, ["forward"])
            await kit.call("waiver.revoke", drive="pump-1")
        async with running_service(store=store) as kit:
            assert (await kit.call("drives.get", drive="pump-1"))["comm_loss"]["waiver"] is None
        drives = tuple(replace(drive, limits=DriveLimits(maximum_hz=30.0)) for drive in DRIVES)
        async with running_service(
            plant_config(drives=drives), store=store
        ) as kit:  # the file was made narrower meanwhile
            assert (await kit.call("drives.get", drive="pump-1"))["maximum_hz"] == 30.0

    run(story())
