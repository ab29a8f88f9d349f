"""End of the service: which drives it stops, which it leaves as they are, and what it reports."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import pytest

from drivebus.errors import (
    DrivebusError,
    ServiceUnavailable,
    StopUnconfirmed,
    Superseded,
)
from drivebus.service.audit import AuditEntry
from drivebus.service.config.model import BusConfig, GroupConfig, OnServiceStop
from drivebus.service.control.stops import DECELERATING
from drivebus.simulator.motor import OutputPhase
from drivebus.testing.virtual_time import run
from drivebus.types import Json
from fixtures.service import BUSES, DRIVES, plant_config, ready, remote_actor, running_service

WITHOUT_RUN_STATE = {"drives": (replace(DRIVES[0], model="df800"),), "buses": (BusConfig("a", "sim://df800@1"),)}


WITHOUT_REPLIES = {"buses": tuple(replace(bus, port=bus.port.replace("@1,2", "@3")) for bus in BUSES)}


WITHOUT_PORT = {"buses": tuple(replace(bus, port="/dev/absent") for bus in BUSES)}


GROUP = GroupConfig(id="fans", drives=("fan-1", "fan-2", "pump-1"), start_interval_s=3.0, max_concurrent_starts=2)


def test_a_drive_whose_status_fails_does_not_keep_an_ending_service_from_stopping_the_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail() -> None:
        raise ValueError("broken")

    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit, "fan-1")
            runtime, station = kit.service.plant.drives["pump-1"], kit.station("fan-1")
            monkeypatch.setattr(logging.getLogger("drivebus.service"), "exception", lambda *_: None)
            monkeypatch.setattr(runtime, "status", fail)
            monkeypatch.setattr(runtime, "state_was_known", False)
            outcomes = await kit.service.stop()
            assert [*outcomes] == ["fan-1"] and station.motor.phase is OutputPhase.OFF
            assert "pump-1" in kit.drives_of_events("plant.left_unknown")

    run(scenario())


@pytest.mark.parametrize("policy", list(OnServiceStop))
def test_a_stopping_service_stops_the_drives_that_it_started_by_their_policy(
    policy: OnServiceStop, caplog: pytest.LogCaptureFixture
) -> None:
    """Drives that others started run on; the log warns of each that may be running."""

    async def scenario() -> None:
        drives = tuple(replace(drive, on_service_stop=policy) for drive in DRIVES)
        async with running_service(plant_config(drives=drives)) as kit:
            await ready(kit, "fan-1")
            kit.station("fan-2").motor.run(20.0)
            await asyncio.sleep(3)
            stations = kit.station("fan-1"), kit.station("fan-2")
            kit.simulated_bus("pump-1").unplug()
            await asyncio.sleep(10)
            outcomes = await kit.service.stop()
            stopped = policy is OnServiceStop.STOP
            assert [*outcomes] == (["fan-1"] if stopped else [])
            ended = [
                (entry.target, entry.outcome, bool(entry.frames))
                for entry in kit.trail.entries
                if entry.what == "drive.stop"
            ]
            assert ended == [("fan-1", "requested", False), ("fan-1", "confirmed", True)] * stopped
            assert [station.motor.phase is OutputPhase.OFF for station in stations] == [stopped, False]
            assert kit.drives_of_events("plant.held") == ([] if stopped else ["fan-1"])
            assert kit.drives_of_events("plant.left_running") == ["fan-2"]
            assert kit.drives_of_events("plant.left_unknown") == ["pump-1", "pump-2"]
            records = [record for record in caplog.records if "running" in record.message]
            left = ["fan-2", "pump-1", "pump-2"] if stopped else ["fan-1", "fan-2", "pump-1", "pump-2"]
            assert [(vars(record)["event"]["drive"], record.levelname) for record in records] == [
                (id, "WARNING") for id in left
            ]

    run(scenario())


@pytest.mark.parametrize("by_service", [True, False], ids=["hold policy", "started by another"])
def test_a_stopping_service_stops_a_drive_whose_ramp_it_holds(by_service: bool) -> None:
    """Nothing else would end the hold: the motor would stay at a frequency that it was only passing."""

    async def scenario() -> None:
        drives = tuple(replace(drive, on_service_stop=OnServiceStop.HOLD) for drive in DRIVES)
        buses = (BUSES[0], replace(BUSES[1], port="sim://vc660@1,2?ramp=20"))
        async with running_service(plant_config(drives=drives, buses=buses)) as kit:
            await ready(kit, *(["pump-1"] if by_service else []))
            station = kit.station("pump-1")
            if not by_service:
                station.motor.run(40.0)
            await asyncio.sleep(2)
            holding = asyncio.create_task(kit.call("drive.hold_ramp", drive="pump-1", seconds=10.0))
            await asyncio.sleep(1)
            assert station.motor.hold
            outcomes = await kit.service.stop()
            assert [*outcomes] == ["pump-1"] and station.motor.phase is OutputPhase.OFF and not station.motor.hold
            with pytest.raises(Superseded):
                await holding

    run(scenario())


@pytest.mark.parametrize("by_service", [True, False], ids=["started by the service", "started at the keypad"])
@pytest.mark.parametrize("lost", [False, True], ids=["answered", "its first frame lost"])
def test_a_service_that_ends_during_the_stop_of_a_drive_that_it_holds_waits_for_that_stop(
    lost: bool, by_service: bool
) -> None:
    """It closed the bus: a stop whose frame was lost was not repeated, and its request ended with an internal error."""

    async def scenario() -> None:
        drives = tuple(replace(drive, on_service_stop=OnServiceStop.HOLD) for drive in DRIVES)
        async with running_service(plant_config(drives=drives)) as kit:
            await ready(kit, *(["fan-1"] if by_service else []))
            station = kit.station("fan-1")
            if not by_service:
                station.motor.run(20.0)
                await asyncio.sleep(2)
            station.faults.silent = lost
            asyncio.get_running_loop().call_later(0.2, setattr, station.faults, "silent", False)
            stop = asyncio.create_task(kit.call("drive.stop", remote_actor("bob"), drive="fan-1"))
            await asyncio.sleep(0.01)
            assert await kit.service.stop() == {}
            assert (await stop)["outcome"]["status"] == "confirmed"
            assert station.motor.phase is OutputPhase.OFF
            assert kit.drives_of_events("plant.held") == kit.drives_of_events("plant.left_running") == []

    run(scenario())


def test_a_stop_that_is_not_confirmed_when_the_service_has_ended_is_reported_as_unknown() -> None:
    """An event named it as kept in its state."""

    async def scenario() -> None:
        drives = tuple(replace(drive, on_service_stop=OnServiceStop.HOLD) for drive in DRIVES)
        buses = (BUSES[0], replace(BUSES[1], port="sim://vc660@1,2?ramp=20"))
        async with running_service(plant_config(drives=drives, buses=buses)) as kit:
            await ready(kit, "pump-1")
            await asyncio.sleep(10)
            stop = asyncio.create_task(kit.call("drive.stop", drive="pump-1"))
            await asyncio.sleep(0.1)
            assert await kit.service.stop() == {"pump-1": None}
            assert kit.drives_of_events("plant.held") == []
            with pytest.raises(DrivebusError):
                await stop

    run(scenario())


@pytest.mark.parametrize(("after_s", "known"), [(0.0, False), (0.2, False), (0.6, True)])
def test_a_service_that_ends_around_the_first_read_of_running_drives_stops_them(after_s: float, known: bool) -> None:
    """A killed service had started them; the supervision of this one has not had its turn since that read."""

    async def scenario() -> None:
        async with running_service() as kit:
            stations = {id: kit.station(id) for id in ("fan-1", "pump-1")}
            for station in stations.values():
                station.motor.run(20.0)
            await asyncio.sleep(after_s)
            runtime = kit.service.plant.drives["fan-1"]
            assert (runtime.status().state.turning, runtime.state_was_known) == (known, False)
            assert (await kit.service.stop()).keys() == stations.keys()
            assert all(station.motor.phase is OutputPhase.OFF for station in stations.values())
            assert kit.drives_of_events("plant.left_unknown") == []

    run(scenario())


@pytest.mark.parametrize(
    "plant", [WITHOUT_RUN_STATE, WITHOUT_REPLIES, WITHOUT_PORT], ids=["run state", "replies", "port"]
)
def test_a_service_that_ends_does_not_wait_for_the_state_of_drives_that_can_not_be_read(plant: Json) -> None:
    async def scenario() -> None:
        async with running_service(plant_config(groups=(), **plant)) as kit:
            drives = list(kit.service.plant.drives)
            await asyncio.sleep(5)
            ends_at = kit.service.plant.now()
            assert await kit.service.stop() == {}
            assert kit.service.plant.now() - ends_at < 0.2
            assert kit.drives_of_events("plant.left_unknown") == drives

    run(scenario())


def test_a_stopping_service_reports_unconfirmed_stops_within_three_seconds() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit, "fan-1")
            kit.simulated_bus("fan-1").unplug()
            started_at = kit.service.plant.now()
            outcomes = await kit.service.stop()
            assert kit.service.plant.now() - started_at <= 3.0
            assert outcomes["fan-1"]["kind"] == "StopUnconfirmed" and "status" not in outcomes["fan-1"]
            assert kit.trail.outcomes("drive.stop") == ["requested", outcomes["fan-1"]["code"]]

    run(scenario())


def test_a_drive_stopped_at_its_keypad_no_longer_counts_as_started_by_the_service() -> None:
    """Started there again, it runs on when the service stops."""

    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit, "fan-1")
            motor = kit.station("fan-1").motor
            motor.stop()
            await asyncio.sleep(8)
            kit.station("fan-1").motor.run(20.0)
            await asyncio.sleep(3)
            assert kit.service.plant.drives["fan-1"].status().state.turning
            assert await kit.service.stop() == {}

    run(scenario())


def test_a_stopping_service_starts_nothing_also_not_the_rest_of_a_group() -> None:
    async def scenario() -> None:
        async with running_service(plant_config(groups=(GROUP,))) as kit:
            await ready(kit)
            start = asyncio.create_task(kit.call("group.start", group="fans", frequency_hz=20.0))
            await asyncio.sleep(2)
            ending = asyncio.create_task(kit.service.stop())
            await asyncio.sleep(0.1)
            with pytest.raises(ServiceUnavailable):
                await kit.call("drive.run", drive="pump-2", frequency_hz=20.0)
            await asyncio.sleep(0.1)
            assert (await kit.call("drive.stop", drive="fan-2"))["outcome"]["status"] == "confirmed"
            found = (await start)["outcomes"]
            assert [found[drive].get("status") for drive in GROUP.drives] == ["confirmed", None, None]
            assert [*(await ending)] == ["fan-1"]

    run(scenario())


def test_a_stopping_service_that_holds_its_drives_starts_no_more_of_them() -> None:
    """Without a stop of its drives, the state of the service ends the group's start."""

    async def scenario() -> None:
        drives = tuple(replace(drive, on_service_stop=OnServiceStop.HOLD) for drive in DRIVES)
        drives = (*drives[:3], replace(drives[3], on_service_stop=OnServiceStop.STOP))
        async with running_service(plant_config(drives=drives, groups=(GROUP,))) as kit:
            await ready(kit, "pump-2")
            start = asyncio.create_task(kit.call("group.start", group="fans", frequency_hz=20.0))
            await asyncio.sleep(2)
            pump = kit.station("pump-1")
            ending = asyncio.create_task(kit.service.stop())
            found = (await start)["outcomes"]
            assert [found[drive].get("code") for drive in GROUP.drives] == [None, "plant.stopping", "plant.stopping"]
            assert [*(await ending)] == ["pump-2"] and pump.motor.starts == 0
            held = [event["drive"] for event in kit.history.events if "on_service_stop = hold" in event["text"]["en"]]
            assert held == [GROUP.drives[0]]

    run(scenario())


def test_a_stopping_service_does_not_wait_for_a_long_ramp() -> None:
    """Within three seconds it reports that the drive decelerates, as the drive itself does; it named a failed stop."""

    async def scenario() -> None:
        buses = (replace(BUSES[0], port="sim://c320@1,2?ramp=30"), BUSES[1])
        async with running_service(plant_config(buses=buses)) as kit:
            await ready(kit, "fan-1")
            await asyncio.sleep(15)
            started_at = kit.service.plant.now()
            number = len(kit.trail.entries) + 1
            assert await kit.service.stop() == {"fan-1": DECELERATING}
            assert kit.service.plant.now() - started_at <= 3.0
            recorded = [(entry.outcome, entry.of) for entry in kit.trail.entries if entry.what == "drive.stop"]
            assert recorded == [("requested", None), ("decelerating", number)], "it was recorded as unknown"
            assert len(kit.trail.entries[-1].frames) > 5, "its record had no frames"

    run(scenario())


@pytest.mark.parametrize("broken", [False, True], ids=["trail that works", "trail that fails"])
def test_an_ending_service_records_its_stops_after_their_first_frames_are_queued(
    broken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The request of every drive was recorded before the first stop began, and no outcome named its request."""

    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit, "fan-1", "fan-2")
            drives = [kit.service.plant.drives[id].drive for id in ("fan-1", "fan-2")]
            begun: list[bool] = []

            def watched(entry: AuditEntry, record: Callable[[AuditEntry], Any]) -> Any:
                if entry.outcome == "requested":
                    begun.extend(drive.stopping for drive in drives)
                return record(entry)

            for name in ("record", "record_nowait"):
                monkeypatch.setattr(kit.trail, name, partial(watched, record=getattr(kit.trail, name)))
            kit.trail.entries.clear()
            kit.trail.broken = broken
            await kit.service.stop()
            assert begun and all(begun)
            recorded = [(entry.target, entry.outcome, entry.of) for entry in kit.trail.entries]
            assert recorded == [
                ("fan-1", "requested", None),
                ("fan-2", "requested", None),
                ("fan-1", "confirmed", None if broken else 1),
                ("fan-2", "confirmed", None if broken else 2),
            ]

    run(scenario())


def test_the_record_of_an_ending_service_whose_stop_failed_has_the_frames_that_were_sent() -> None:
    """It had none, so that the trail did not show that a stop was sent to a drive without a reply."""

    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit, "fan-1")
            await asyncio.sleep(10)
            kit.station("fan-1").faults.silent = True
            outcome = (await kit.service.stop())["fan-1"]["outcome"]
            assert outcome["frames"] and list(kit.trail.entries[-1].frames) == outcome["frames"]

    run(scenario())


@pytest.mark.parametrize("replies_again", [False, True], ids=["silent", "decelerates"])
def test_a_stop_that_is_still_repeated_when_the_service_ends_has_a_last_record_with_its_author(
    replies_again: bool,
) -> None:
    """The trail left open whether the service had still been stopping the drive when it ended."""

    async def scenario() -> None:
        drives = tuple(replace(drive, on_service_stop=OnServiceStop.HOLD) for drive in DRIVES)
        buses = (replace(BUSES[0], port="sim://c320@1,2?ramp=30"), BUSES[1])
        async with running_service(plant_config(drives=drives, buses=buses)) as kit:
            await ready(kit, "fan-1")
            await asyncio.sleep(35)
            kit.trail.entries.clear()
            kit.station("fan-1").faults.silent = True
            with pytest.raises(StopUnconfirmed):
                await kit.call("drive.stop", remote_actor("bob"), drive="fan-1")
            kit.station("fan-1").faults.silent = not replies_again
            await asyncio.sleep(6)  # the bus reads the drive again after 5 s
            assert await kit.service.stop() == {"fan-1": DECELERATING if replies_again else None}
            recorded = [(entry.who, entry.outcome, entry.of) for entry in kit.trail.entries]
            assert recorded == [
                ("bob", "requested", None),
                ("bob", "drives.stop_no_reply", 1),
                ("drivebus", "decelerating" if replies_again else "unknown", 1),
            ]
            assert kit.trail.entries[-1].params == {"requested_by": "bob"}

    run(scenario())


@pytest.mark.parametrize("policy", list(OnServiceStop))
def test_the_record_of_a_stop_whose_ramp_outlasts_the_service_has_what_was_sent_and_reported(
    policy: OnServiceStop,
) -> None:
    """It was recorded, and answered, as one of which nothing was sent."""

    async def scenario() -> None:
        drives = tuple(replace(drive, on_service_stop=policy) for drive in DRIVES)
        buses = (replace(BUSES[0], port="sim://c320@1,2?ramp=30"), BUSES[1])
        async with running_service(plant_config(drives=drives, buses=buses)) as kit:
            await ready(kit, "fan-1")
            await asyncio.sleep(35)
            kit.trail.entries.clear()
            stop = asyncio.create_task(kit.call("drive.stop", remote_actor("bob"), drive="fan-1"))
            await asyncio.sleep(0.5)
            assert await kit.service.stop() == {"fan-1": DECELERATING}
            with pytest.raises(StopUnconfirmed) as caught:
                await stop
            assert caught.value.key == "drives.stop_removed_after" and caught.value.params["sent"] > 1
            assert "reported decelerating" in caught.value.text("en") and "减速" in caught.value.text("zh")
            recorded = [(entry.who, entry.outcome, entry.of) for entry in kit.trail.entries]
            by_service = [("drivebus", "requested", None), ("drivebus", "decelerating", 2)]
            assert recorded == [
                ("bob", "requested", None),
                *(by_service if policy is OnServiceStop.STOP else []),
                ("bob", caught.value.key, 1),
            ]
            assert len(kit.trail.entries[-1].frames) > 20

    run(scenario())


def test_an_ending_service_does_not_wait_for_a_disk_that_hangs() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit, "fan-1")
            kit.trail.delay_s = 60.0
            started_at = kit.service.plant.now()
            assert (await kit.service.stop())["fan-1"]["status"] == "confirmed"
            assert kit.service.plant.now() - started_at <= 3.0
            assert (kit.trail.entries[-1].outcome, kit.trail.entries[-1].of) == ("confirmed", None)

    run(scenario())
