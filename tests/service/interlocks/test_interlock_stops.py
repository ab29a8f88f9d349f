"""Interlocks in a running service over simulated drives, in virtual time."""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from dataclasses import replace
from typing import Any

import pytest

from drivebus.errors import Interlocked
from drivebus.service.alarms import SystemAlarm
from drivebus.service.config.model import BusConfig, DriveConfig, InterlockAction, InterlockConfig, PlantConfig
from drivebus.simulator.motor import OutputPhase
from drivebus.testing.virtual_time import run
from drivebus.values import Quality, Text
from fixtures.service import plant_config, running_service

AIR = InterlockConfig(
    id="air",
    drives=("pump-1",),
    require="fan-1.state == running and fan-1.output_frequency > 5 Hz",
    delay_s=1.0,
    title=Text("Air", "送风"),
)


async def start_both(kit: Any) -> None:
    await kit.grant_waivers()
    await kit.call("drive.run", drive="fan-1", frequency_hz=20.0)
    await asyncio.sleep(6)
    await kit.call("drive.run", drive="pump-1", frequency_hz=20.0)
    await asyncio.sleep(6)


def test_a_violated_interlock_is_shown_as_start_blocker_and_rejects_a_start() -> None:
    async def scenario() -> None:
        async with running_service(plant_config(interlocks=(AIR,))) as kit:
            await asyncio.sleep(15)
            await kit.grant_waivers()
            await asyncio.sleep(1)
            blocked = (await kit.call("drives.get", drive="pump-1"))["start_blockers"]
            assert [blocker["key"] for blocker in blocked] == ["interlocks.violated"]
            assert blocked[0]["params"]["interlock"] == "air"
            assert "fan-1.state is stopped" in blocked[0]["text"]["en"] and "送风" in blocked[0]["text"]["zh"]
            with pytest.raises(Interlocked, match=r"fan-1\.output_frequency is 0 Hz"):
                await kit.call("drive.run", drive="pump-1", frequency_hz=20.0)
            assert kit.station("pump-1").motor.phase is OutputPhase.OFF
            assert (await kit.call("drives.get", drive="fan-1"))["start_blockers"] == []

    run(scenario())


@pytest.mark.parametrize("broken", ["alarms.observe", "view", "status"])
def test_an_interlock_does_not_go_on_with_an_old_view_where_a_part_of_the_supervision_fails(
    monkeypatch: pytest.MonkeyPatch, broken: str
) -> None:
    """The drive that it requires had long stopped, and was still *running* for it."""

    async def scenario() -> None:
        async with running_service(plant_config(interlocks=(AIR,))) as kit:
            await asyncio.sleep(15)
            await start_both(kit)
            plant = kit.service.plant
            with monkeypatch.context() as context:
                context.setattr(logging.getLogger("drivebus.service"), "exception", lambda *_: None)
                if broken == "view":
                    context.setattr(kit.service.publisher, "publish_drive", fail)
                elif broken == "status":
                    context.setattr(plant.drives["fan-1"], "status", fail)
                else:
                    part, name = broken.split(".")
                    context.setattr(getattr(plant, part), name, fail)
                kit.station("fan-1").motor.stop()
                await asyncio.sleep(8)
                assert kit.station("pump-1").motor.phase is OutputPhase.OFF

    def fail(*_: Any) -> None:
        raise ValueError("broken")

    run(scenario())


def test_a_drive_that_stops_answering_trips_the_drives_that_require_it() -> None:
    """Values are stale after max(3 × 0.5 s, 1 s) and the timeout; the stop follows after the delay of 1 s."""

    async def scenario() -> None:
        async with running_service(plant_config(interlocks=(AIR,))) as kit:
            await asyncio.sleep(15)
            await start_both(kit)
            assert kit.station("pump-1").running
            kit.station("fan-1").faults.silent = True
            await asyncio.sleep(1.4)
            assert kit.service.plant.drives["pump-1"].drive.stop_pending is False and kit.station("pump-1").running
            await asyncio.sleep(6.0)
            assert kit.station("pump-1").motor.phase is OutputPhase.OFF

    run(scenario())


def test_a_lost_port_violates_the_interlocks_of_its_drives_at_once_and_is_seen_everywhere() -> None:
    """The drive that is required runs on; that it does is no longer known."""
    closed = InterlockConfig(id="closed", drives=("pump-2",), require="not fan-1.output_frequency > 40 Hz")

    async def scenario() -> None:
        async with running_service(plant_config(interlocks=(AIR, closed))) as kit:
            await asyncio.sleep(15)
            await start_both(kit)
            assert (await kit.call("drives.get", drive="pump-2"))["start_blockers"] == []
            kit.simulated_bus("fan-1").unplug()
            await asyncio.sleep(0.3)
            fan = await kit.call("drives.get", drive="fan-1")
            assert (fan["presence"], fan["state"], fan["state_reason"]) == ("offline", "unknown", "drives.port_lost")
            assert {signal["quality"] for signal in fan["signals"].values()} == {"bad"}
            last = [sample for sample in kit.history.samples if sample.tag == "fan-1.output_frequency"][-1]
            assert (last.value, last.quality) == (None, Quality.BAD)
            for pump in ("pump-1", "pump-2"):
                blocked = (await kit.call("drives.get", drive=pump))["start_blockers"]
                assert [blocker["key"] for blocker in blocked] == ["interlocks.violated"]
            assert kit.station("pump-1").running and not kit.service.plant.drives["pump-1"].drive.stop_pending
            await asyncio.sleep(1.5)
            stops = [event for event in kit.history.events if event["kind"] == "stop"]
            assert [event["drive"] for event in stops] == ["pump-1"]
            await asyncio.sleep(4.5)
            assert kit.station("pump-1").motor.phase is OutputPhase.OFF
            with pytest.raises(Interlocked, match=r"fan-1\.state"):
                await kit.call("drive.run", drive="pump-1", frequency_hz=20.0)

    run(scenario())


def test_a_stop_that_is_being_repeated_is_not_commanded_again() -> None:
    async def scenario() -> None:
        async with running_service(plant_config(interlocks=(AIR,))) as kit:
            await asyncio.sleep(15)
            await start_both(kit)
            for drive in ("fan-1", "pump-1"):
                kit.station(drive).faults.silent = True
            await asyncio.sleep(20)
            assert kit.service.plant.drives["pump-1"].drive.stop_pending
            events = [event for _, event in kit.service.plant.hub.items("events") if event["kind"] == "stop"]
            assert [event["drive"] for event in events] == ["pump-1"]
            kit.station("pump-1").faults.silent = False
            await asyncio.sleep(5)
            assert kit.station("pump-1").motor.phase is OutputPhase.OFF

    run(scenario())


def interlock_alarms(kit: Any) -> list[tuple[str, str, bool]]:
    """Return drive, interlock, and whether the alarm is uncleared."""
    active = kit.service.plant.alarms.active()
    trips = [alarm for alarm in active if alarm.kind == SystemAlarm.INTERLOCK_TRIP]
    return [(alarm.drive, alarm.subject, alarm.cleared_ms is None) for alarm in trips]


def test_an_interlock_alarm_is_raised_for_a_stopped_drive_and_not_for_one_at_rest() -> None:
    """At rest no interlock that requires a running drive holds; that is no trip."""
    block = replace(AIR, id="block", drives=("pump-2",), action=InterlockAction.BLOCK_START)

    async def scenario() -> None:
        async with running_service(plant_config(interlocks=(AIR, block))) as kit:
            await asyncio.sleep(15)
            assert interlock_alarms(kit) == []
            await start_both(kit)
            await kit.call("drive.run", drive="pump-2", frequency_hz=20.0)
            await asyncio.sleep(6)
            await kit.call("drive.stop", drive="fan-1")
            await asyncio.sleep(6)
            assert interlock_alarms(kit) == [("pump-1", "air", True)]
            assert kit.station("pump-1").motor.phase is OutputPhase.OFF and kit.station("pump-2").running
            await kit.call("drive.run", drive="fan-1", frequency_hz=20.0)
            await asyncio.sleep(6)
            assert interlock_alarms(kit) == [("pump-1", "air", False)], "it holds again"

    run(scenario())


def test_a_violation_shorter_than_the_delay_trips_nothing() -> None:
    async def scenario() -> None:
        async with running_service(plant_config(interlocks=(AIR,))) as kit:
            await asyncio.sleep(15)
            await start_both(kit)
            kit.station("fan-1").faults.silent = True
            await asyncio.sleep(0.4)
            kit.station("fan-1").faults.silent = False
            await asyncio.sleep(5.0)
            assert kit.station("pump-1").running

    run(scenario())


def test_a_new_setpoint_does_not_trip_an_interlock_that_requires_running() -> None:
    """A C320 reports acceleration and deceleration as separate states."""

    async def scenario() -> None:
        async with running_service(plant_config(interlocks=(AIR,))) as kit:
            await asyncio.sleep(15)
            await start_both(kit)
            for frequency_hz in (45.0, 10.0):
                await kit.call("drive.set_frequency", drive="fan-1", frequency_hz=frequency_hz)
                await asyncio.sleep(5.0)
                assert kit.station("pump-1").running

    run(scenario())


def test_a_drive_at_rest_whose_status_fails_does_not_keep_an_interlock_from_stopping_the_next(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail() -> None:
        raise ValueError("broken")

    async def scenario() -> None:
        air = replace(AIR, drives=("pump-1", "pump-2"))
        async with running_service(plant_config(interlocks=(air,))) as kit:
            await asyncio.sleep(15)
            await kit.grant_waivers()
            for drive in ("fan-1", "pump-2"):
                await kit.call("drive.run", drive=drive, frequency_hz=20.0)
                await asyncio.sleep(6)
            with monkeypatch.context() as context:
                context.setattr(logging.getLogger("drivebus.service"), "exception", lambda *_: None)
                context.setattr(kit.service.plant.drives["pump-1"], "status", fail)
                kit.station("fan-1").motor.stop()
                await asyncio.sleep(8)
                assert kit.station("pump-2").motor.phase is OutputPhase.OFF

    run(scenario())


def full_bus_config(model: str, count: int) -> PlantConfig:
    """Return a plant whose pumps, all on one bus, require that the fan on another runs."""
    pumps = tuple(
        DriveConfig(id=f"pump-{number}", bus="b", address=number, model=model) for number in range(1, count + 1)
    )
    fan = DriveConfig(id="fan-1", bus="a", address=1, model="c320")
    buses = (
        BusConfig(id="a", port="sim://c320@1?ramp=1"),
        BusConfig(id="b", port=f"sim://{model}@1-{count}?ramp=1"),
    )
    air = InterlockConfig(id="air", drives=tuple(pump.id for pump in pumps), require="fan-1.state == running")
    return plant_config(buses=buses, drives=(fan, *pumps), interlocks=(air,))


async def run_at_keypads(kit: Any) -> None:
    """Start the fan and then every pump, and wait until each of them was read: a full bus takes up to 16 s."""
    await asyncio.sleep(16)
    kit.station("fan-1").motor.run(20.0)
    for id in kit.service.plant.drives:
        if id != "fan-1":
            kit.station(id).motor.run(20.0)
    await asyncio.sleep(16)


@pytest.mark.parametrize(("model", "count"), [("c320", 12), ("vc660", 20), ("md500_plus", 12), ("dzb100", 12)])
def test_an_interlock_that_stops_all_drives_of_a_bus_raises_no_alarm_of_an_unconfirmed_stop(
    model: str, count: int
) -> None:
    """Each had the time of one drive, although all are read in turns: every one of eight C320 was reported."""

    async def scenario() -> None:
        async with running_service(full_bus_config(model, count)) as kit:
            await run_at_keypads(kit)
            kit.station("fan-1").motor.stop()
            await asyncio.sleep(25)
            raised = Counter(alarm.kind for alarm in kit.service.plant.alarms.active())
            assert raised == {SystemAlarm.INTERLOCK_TRIP: count}

    run(scenario())


def test_an_interlock_stops_a_drive_of_which_only_the_last_known_state_shows_that_it_turns() -> None:
    """Started at its keypad, it was stopped when its turn to be read came again, after the reads of all other stops."""

    async def scenario() -> None:
        async with running_service(full_bus_config("dzb100", 12)) as kit:
            await run_at_keypads(kit)
            drives = kit.service.plant.drives
            assert any(drive.state_is_unknown for drive in drives.values()), "the bus is too full to know every state"
            kit.station("fan-1").motor.stop()
            await asyncio.sleep(3)
            assert not any(kit.station(id).motor.energised for id in drives)

    run(scenario())


def test_an_interlock_sends_no_stop_to_a_drive_that_stood_when_its_state_was_known_last() -> None:
    async def scenario() -> None:
        async with running_service(plant_config(interlocks=(AIR,))) as kit:
            await asyncio.sleep(15)
            kit.station("pump-1").faults.silent = True
            await asyncio.sleep(15)
            pump = kit.service.plant.drives["pump-1"]
            assert pump.state_is_unknown and not pump.drive.stopping
            assert interlock_alarms(kit) == []

    run(scenario())


def test_an_interlock_sends_no_stops_to_a_drive_that_turned_and_does_not_answer_any_more() -> None:
    """Each second one to each drive of a dark cabinet starved the others of the bus; a sound motor was stopped."""

    async def scenario() -> None:
        async with running_service(full_bus_config("c320", 4)) as kit:
            await run_at_keypads(kit)
            pump = kit.service.plant.drives["pump-1"]
            kit.station("pump-1").faults.silent = True
            await asyncio.sleep(15)
            assert pump.state_is_unknown and pump.last_known_turning
            kit.station("fan-1").motor.stop()
            await asyncio.sleep(5)
            assert not pump.drive.stopping and interlock_alarms(kit)
            assert "pump-1" not in {drive for drive, *_ in interlock_alarms(kit)}

    run(scenario())


def test_a_drive_that_is_not_polled_and_has_confirmed_its_stop_is_not_stopped_again() -> None:
    """After a reload that had restarted the polls, its last known state was that of the time before the stop."""

    async def scenario() -> None:
        async with running_service(full_bus_config("c320", 1)) as kit:
            await run_at_keypads(kit)
            pump = kit.service.plant.drives["pump-1"]
            pump.stop_monitor()
            assert pump.may_turn
            await kit.call("drive.stop", drive="pump-1")
            assert pump.state_is_unknown and not pump.may_turn

    run(scenario())
