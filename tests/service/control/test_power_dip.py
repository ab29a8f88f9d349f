"""A drive of the service that loses its supply for a moment: what it does by itself afterwards is announced."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from drivebus.drives.state import DriveState
from drivebus.service.alarms import Alarm
from drivebus.service.api.errors import localized
from drivebus.testing.virtual_time import run
from fixtures.receiver import wait_until
from fixtures.service import ServiceKit, plant_config, running_service

DRIVE = "fan-1"
SET_HZ, KEYPAD_HZ = 20.0, 50.0
FIRST_READS_S, RAMP_S = 5.0, 25.0


async def running_drive(kit: ServiceKit, drive: str = DRIVE) -> Any:
    """Run the drive at ``SET_HZ``, and return its simulated station."""
    await asyncio.sleep(FIRST_READS_S)
    await kit.grant_waivers()
    await kit.call("drive.run", drive=drive, frequency_hz=SET_HZ)
    await asyncio.sleep(RAMP_S)
    kit.history.events.clear()
    return kit.station(drive)


def speed_alarms(kit: ServiceKit) -> list[Alarm]:
    """Return the alarms of another speed, also a cleared one that is not acknowledged."""
    return [alarm for alarm in kit.service.plant.alarms.active() if alarm.kind == "other_speed"]


def standstill_events(kit: ServiceKit) -> list[Any]:
    sentence = localized("plant.stopped_by_itself")
    return [event for event in kit.history.events if event["text"] == sentence]


@pytest.mark.parametrize("dip_s", [0.3, 5.0])
def test_a_drive_that_runs_again_by_itself_at_the_frequency_of_its_keypad_raises_an_alarm(dip_s: float) -> None:
    """A short dip costs no reply; only the speed shows it."""

    async def go() -> None:
        async with running_service(plant_config()) as kit:
            station = await running_drive(kit)
            assert speed_alarms(kit) == []
            station.power_cycle(dip_s)
            station.keypad_run(KEYPAD_HZ)
            await asyncio.sleep(dip_s + 60.0)
            (alarm,) = speed_alarms(kit)
            assert alarm.text.en == "Fan 1 runs at 50 Hz and was set to 20 Hz"
            assert alarm.text.zh == "风机 1 以 50 Hz 运行，而设定频率为 20 Hz"
            assert alarm.cleared_ms is None and standstill_events(kit) == []
            await kit.call("drive.set_frequency", drive=DRIVE, frequency_hz=30.0)
            await asyncio.sleep(60.0)
            assert [alarm.cleared_ms is None for alarm in speed_alarms(kit)] == [False]

    run(go())


def test_a_drive_that_is_paused_soon_after_it_kept_another_speed_raises_no_alarm() -> None:
    """No read has shown the other speed for long enough, and the drive does not run at it any longer."""

    async def go() -> None:
        async with running_service(plant_config()) as kit:
            station = await running_drive(kit, "pump-1")
            station.power_cycle(0.3)
            station.keypad_run(KEYPAD_HZ)
            difference = kit.service.plant.drives["pump-1"].speed_difference
            await wait_until(lambda: difference.since is not None)
            await kit.call("drive.pause", drive="pump-1")
            await asyncio.sleep(60.0)
            assert kit.service.plant.drives["pump-1"].status().state is DriveState.PAUSED
            assert difference.since is not None and speed_alarms(kit) == []

    run(go())


@pytest.mark.parametrize("dip_s", [0.3, 5.0])
def test_a_drive_that_stays_stopped_after_a_dip_is_an_event_once(dip_s: float) -> None:
    async def go() -> None:
        async with running_service(plant_config()) as kit:
            station = await running_drive(kit)
            station.power_cycle(dip_s)
            await asyncio.sleep(dip_s + 40.0)
            assert len(standstill_events(kit)) == 1 and speed_alarms(kit) == []
            view = await kit.call("drives.get", drive=DRIVE)
            assert (view["state"], view["commanded_hz"]) == ("stopped", None)

    run(go())


def test_a_drive_that_runs_again_by_itself_after_a_standstill_is_an_event() -> None:
    """It ran at 50 Hz without a word: the standstill had ended what the service knew of its own start."""

    async def go() -> None:
        async with running_service(plant_config()) as kit:
            station = await running_drive(kit)
            station.power_cycle(1.0)
            await asyncio.sleep(12.0)
            station.keypad_run(KEYPAD_HZ)
            await asyncio.sleep(30.0)
            sentence = localized("plant.started_by_itself")
            assert [event["drive"] for event in kit.history.events if event["text"] == sentence] == [DRIVE]
            await kit.call("drive.stop", drive=DRIVE)
            await kit.call("drive.run", drive=DRIVE, frequency_hz=SET_HZ)
            await asyncio.sleep(30.0)
            assert len([event for event in kit.history.events if event["text"] == sentence]) == 1

    run(go())


def test_a_drive_that_is_set_to_other_frequencies_and_stopped_raises_neither() -> None:
    async def go() -> None:
        async with running_service(plant_config()) as kit:
            await running_drive(kit)
            for frequency_hz in (45.0, 5.0):
                await kit.call("drive.set_frequency", drive=DRIVE, frequency_hz=frequency_hz)
                await asyncio.sleep(60.0)
            await kit.call("drive.stop", drive=DRIVE)
            await asyncio.sleep(30.0)
            assert kit.service.plant.drives[DRIVE].status().state is DriveState.STOPPED
            assert standstill_events(kit) == [] and speed_alarms(kit) == []
            assert [event for event in kit.history.events if event["kind"] == "start"] == []

    run(go())
