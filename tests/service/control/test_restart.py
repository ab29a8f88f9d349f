"""Start of the service: it sends nothing but reads, and raises an alarm for a running drive or stops it by policy."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Any

import pytest

from drivebus import i18n
from drivebus.bus.trace import TraceKind
from drivebus.drives import MemoryStore
from drivebus.drives.context import DriveLimits
from drivebus.errors import InvalidParameters, StopUnconfirmed
from drivebus.protocols.codec import Effect
from drivebus.service.app import Service
from drivebus.service.config.model import BusConfig, InterlockConfig, OnRestart, OnServiceStop
from drivebus.simulator.motor import OutputPhase
from drivebus.simulator.port import find_simulated_bus
from drivebus.testing.virtual_time import run
from drivebus.values import Text
from fixtures.service import BUSES, DRIVES, ServiceKit, plant_config, running_service

SHARED_BUSES = tuple(BusConfig(bus.id, f"{bus.port}&name=shared-{bus.id}") for bus in BUSES)
"""Simulated buses that stay when a service ends and the next one starts."""


def effects(service: Service) -> set[Effect]:
    """Return the effects of all sent frames."""
    return {
        drive.drive.dialect.station_config.effect_of(frame.event.data)
        for drive in service.plant.drives.values()
        for frame in service.plant.bus_of(drive).frames
        if frame.event.kind is TraceKind.SENT and frame.event.station == drive.config.address
    }


async def start_and_kill(kit: ServiceKit) -> None:
    """Start the fan, and end the service as SIGKILL would: it stops nothing."""
    await kit.grant_waivers()
    await asyncio.sleep(5)
    await kit.call("drive.run", drive="fan-1", frequency_hz=20.0)
    kit.service.plant.drives["fan-1"].started_by_service = False
    await kit.service.stop()


@pytest.mark.parametrize("policy", list(OnRestart))
def test_a_drive_found_running_is_left_running_or_stopped_and_never_started(policy: OnRestart) -> None:
    """An earlier service started it and was killed."""

    async def scenario() -> None:
        drives = tuple(replace(drive, on_restart=policy) for drive in DRIVES)
        chosen = plant_config(buses=SHARED_BUSES, drives=drives)
        async with running_service(chosen) as first:
            await start_and_kill(first)
            bench: Any = find_simulated_bus("shared-a")
            assert bench.station(1).motor.phase is not OutputPhase.OFF
            service = Service(chosen, replace(first.storage, settings=MemoryStore(), drives=MemoryStore()))
            async with service:
                await asyncio.sleep(8)
                texts = [alarm.text.en for alarm in service.plant.alarms.active() if alarm.cleared_ms is None]
                running = i18n.text("alarms.text.running_at_start", drive="Fan 1")
                stopped = i18n.text("plant.stopped_on_restart")
                events = [event["text"]["en"] for _, event in service.plant.hub.items("events")]
                assert (running in texts, stopped in events) == (policy is not OnRestart.STOP, policy is OnRestart.STOP)
                kinds = {alarm.kind for alarm in service.plant.alarms.active() if alarm.cleared_ms is None}
                if policy is OnRestart.STOP:
                    assert effects(service) <= {Effect.NONE, Effect.STOP}
                    assert bench.station(1).motor.phase is OutputPhase.OFF
                    by_service = [entry.what for entry in first.trail.entries if entry.who == "drivebus"]
                    assert by_service == ["drive.stop"] * 2, "its request and its outcome"
                else:
                    assert effects(service) == {Effect.NONE}
                    assert bench.station(1).motor.phase is not OutputPhase.OFF
                    assert "running_at_start" in kinds

    run(scenario())


@pytest.mark.parametrize("policy", list(OnServiceStop))
def test_an_ordered_end_stops_adopted_drives_and_names_those_that_it_leaves_running(policy: OnServiceStop) -> None:
    async def scenario() -> None:
        drives = tuple(replace(drive, on_service_stop=policy) for drive in DRIVES)
        chosen = plant_config(buses=SHARED_BUSES, drives=drives)
        async with running_service(chosen) as first:
            await start_and_kill(first)
            fans: Any = find_simulated_bus("shared-a")
            pumps: Any = find_simulated_bus("shared-b")
            service = Service(chosen, replace(first.storage, settings=MemoryStore(), drives=MemoryStore()))
            await service.start()
            await asyncio.sleep(8)
            pumps.station(1).keypad_run(15.0)
            pumps.station(2).faults.silent = True
            await asyncio.sleep(8)
            first.history.events.clear()
            outcomes = await service.stop()
            left = {
                event["drive"]: event["text"]["en"] for event in first.history.events if event["kind"] == "not_stopped"
            }
            assert "neither started it" in left["pump-1"] and "not known" in left["pump-2"]
            await asyncio.sleep(6)
            running = fans.station(1).motor.phase is not OutputPhase.OFF
            if policy is OnServiceStop.STOP:
                assert outcomes["fan-1"]["status"] == "confirmed" and not running
                assert left.keys() == {"pump-1", "pump-2"}
            else:
                assert outcomes == {} and running and "on_service_stop = hold" in left["fan-1"]

    run(scenario())


def test_the_start_of_the_service_sends_only_reads() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(30)
            assert effects(kit.service) == {Effect.NONE}

    run(scenario())


def test_an_adopted_drive_may_be_running_until_it_is_reported_at_standstill() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(5)
            drive = kit.service.plant.drives["fan-1"]
            drive.adopted = True
            assert not drive.turning and drive.may_be_running
            await asyncio.sleep(5)
            assert not drive.may_be_running

    run(scenario())


def test_an_interlock_stops_a_running_drive_and_blocks_its_start() -> None:
    async def scenario() -> None:
        interlock = InterlockConfig(id="fan-first", drives=("pump-1",), require="fan-1.output_frequency > 5 Hz")
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
            assert (await kit.call("drives.get", drive="pump-1"))["last_stop"]["kind"] == "automatic"

    run(scenario())


def trip_announcements(kit: ServiceKit) -> list[str]:
    events = kit.event_texts()
    return [text for text in events if "Fan 1 first" in text and "stop request" in text]


def test_a_trip_is_announced_once_while_the_port_is_lost_and_again_for_a_drive_that_is_started_at_its_keypad() -> None:
    async def scenario() -> None:
        interlock = InterlockConfig(
            id="fan-first",
            title=Text("Fan 1 first", "先开风机 1"),
            drives=("fan-2",),
            require="fan-1.state == running",
        )
        async with running_service(plant_config(interlocks=(interlock,))) as kit:
            await asyncio.sleep(15)
            await kit.grant_waivers()
            await kit.call("drive.run", drive="fan-1", frequency_hz=20.0)
            await asyncio.sleep(4)
            await kit.call("drive.run", drive="fan-2", frequency_hz=20.0)
            await asyncio.sleep(4)
            bench: Any = kit.simulated_bus("fan-1")
            bench.unplug()
            await asyncio.sleep(5)
            for _ in range(4):
                with pytest.raises(StopUnconfirmed):
                    await kit.call("drive.stop", drive="fan-2")
                await asyncio.sleep(2)
            assert trip_announcements(kit) == ['stop requested by interlock "Fan 1 first"']
            alarms = [alarm.text.en for alarm in kit.service.plant.alarms.active()]
            assert 'Fan 2: interlock "Fan 1 first" does not hold; a stop is requested' in alarms
            by_service = [entry for entry in kit.trail.entries if (entry.what, entry.who) == ("drive.stop", "drivebus")]
            assert [entry.outcome for entry in by_service] == ["requested", "plant.stop_not_sent_port"]
            kit.station("fan-1").keypad_stop()
            bench.replug()
            await asyncio.sleep(10)
            assert kit.station("fan-2").motor.phase is OutputPhase.OFF
            kit.station("fan-2").keypad_run(15.0)
            await asyncio.sleep(10)
            assert kit.station("fan-2").motor.phase is OutputPhase.OFF
            assert trip_announcements(kit) == ['stop requested by interlock "Fan 1 first"'] * 2

    run(scenario())


def test_waivers_and_limits_survive_a_restart_within_the_limits_of_the_file() -> None:
    async def scenario() -> None:
        store = MemoryStore()
        async with running_service(store=store) as kit:
            await kit.grant_waivers("pump-1")
            limits = {"minimum_hz": 5.0, "maximum_hz": 40.0, "forward": True, "reverse": False}
            await kit.call("drive.limits", drive="pump-1", **limits)
            with pytest.raises(Exception, match="limits of pump-1"):
                await kit.call("drive.limits", drive="pump-1", **limits | {"maximum_hz": 900.0})
        async with running_service(store=store) as kit:
            view = await kit.call("drives.get", drive="pump-1")
            assert view["comm_loss"]["waiver"] == "test bench (tester)"
            assert (view["minimum_hz"], view["maximum_hz"], view["directions"]) == (5.0, 40.0, ["forward"])
            await kit.call("waiver.revoke", drive="pump-1")
        async with running_service(store=store) as kit:
            assert (await kit.call("drives.get", drive="pump-1"))["comm_loss"]["waiver"] is None
        drives = tuple(replace(drive, limits=DriveLimits(maximum_hz=30.0)) for drive in DRIVES)
        narrowed = plant_config(drives=drives)
        async with running_service(narrowed, store=store) as kit:
            assert (await kit.call("drives.get", drive="pump-1"))["maximum_hz"] == 30.0

    run(scenario())


@pytest.mark.parametrize("omitted", ["minimum_hz", "maximum_hz", "forward", "reverse"])
def test_a_change_of_limits_that_leaves_one_out_is_refused_and_loosens_none(omitted: str) -> None:
    """A lower maximum without the directions permitted reverse again."""

    async def scenario() -> None:
        async with running_service() as kit:
            forbidden = {"minimum_hz": 5.0, "maximum_hz": 40.0, "forward": True, "reverse": False}
            await kit.call("drive.limits", drive="pump-1", **forbidden)
            before = kit.service.plant.drives["pump-1"].drive.limits
            incomplete = {name: value for name, value in forbidden.items() if name != omitted}
            with pytest.raises(InvalidParameters, match=omitted):
                await kit.call("drive.limits", drive="pump-1", **incomplete)
            assert kit.service.plant.drives["pump-1"].drive.limits == before

    run(scenario())
