"""Limits and motors at a reload: what still holds for another motor, what runs above a limit, what may still turn."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from drivebus.drives import MemoryStore
from drivebus.errors import LimitError, ServiceError
from drivebus.service.api.errors import localized
from drivebus.service.config.load import load
from drivebus.simulator.port import simulated_bus_of
from drivebus.testing.virtual_time import run
from drivebus.values import Text
from fixtures.service import WIDEST_LIMITS, ServiceKit, running_service

HEAD = """
format = 1
[plant]
id = "hall"
[bus.a]
port = "sim://c320@1-3?ramp=2&name=a"
"""
FAN_1 = '[drive.fan-1]\nbus = "a"\naddress = 1\nmodel = "c320"\n'
FAN_2 = '[drive.fan-2]\nbus = "a"\naddress = 2\nmodel = "c320"\n'
OTHER_FAN_1 = FAN_1.replace("address = 1", "address = 3")
FILE_LIMITS = "[drive.fan-1.limits]\nmaximum_hz = 20.0\n"


def write(path: Path, *parts: str, head: str = HEAD) -> Path:
    path.write_text(head + "".join(parts))
    return path


async def range_hz(kit: ServiceKit) -> tuple[float, float]:
    view = await kit.call("drives.get", drive="fan-1")
    return view["minimum_hz"], view["maximum_hz"]


@pytest.mark.parametrize("restart", [False, True])
def test_limits_hold_for_another_motor_of_the_same_name_within_its_own_and_an_event_says_so(
    tmp_path: Path, restart: bool
) -> None:
    file, store = write(tmp_path / "plant.toml", FAN_1), MemoryStore()
    former = {"model": "c320", "port": "sim://c320@1-3?ramp=2&name=a", "address": 1}

    async def check(kit: ServiceKit) -> None:
        assert await range_hz(kit) == (5.0, 20.0), "the stricter of both"
        assert kit.drives_of_events("plant.limits_of_another", **former) == ["fan-1"]
        assert (await kit.call("drives.get", drive="fan-1"))["comm_loss"]["waiver"] is None
        with pytest.raises(LimitError):
            await kit.call("drive.limits", drive="fan-1", **WIDEST_LIMITS | {"maximum_hz": 30.0})
        await kit.call("drive.limits", drive="fan-1", **WIDEST_LIMITS | {"maximum_hz": 15.0})
        kit.history.events.clear()
        write(file, OTHER_FAN_1, FILE_LIMITS, FAN_2)
        await kit.call("configuration.reload")
        assert await range_hz(kit) == (0.0, 15.0)
        assert kit.drives_of_events("plant.limits_of_another", **former) == []

    async def scenario() -> None:
        async with running_service(load(file), store=store) as kit:
            await asyncio.sleep(2)
            await kit.grant_waivers()
            await kit.call("drive.limits", drive="fan-1", **WIDEST_LIMITS | {"minimum_hz": 5.0, "maximum_hz": 40.0})
            write(file, OTHER_FAN_1, FILE_LIMITS)
            if not restart:
                await kit.call("configuration.reload")
                await check(kit)
        if restart:
            async with running_service(load(file), store=store) as kit:
                await check(kit)

    run(scenario())


def test_a_lower_limit_says_which_drives_run_above_it_and_slows_none(tmp_path: Path) -> None:
    file = write(tmp_path / "plant.toml", FAN_1, FAN_2)

    async def scenario() -> None:
        async with running_service(load(file)) as kit:
            await asyncio.sleep(2)
            await kit.grant_waivers()
            for drive in ("fan-1", "fan-2"):
                await kit.call("drive.run", drive=drive, frequency_hz=40.0)
            await asyncio.sleep(5)
            answer = await kit.call("drive.limits", drive="fan-2", **WIDEST_LIMITS | {"maximum_hz": 30.0})
            params = {"frequency_hz": 40.0, "maximum_hz": 30.0}
            assert answer["note"] == localized("plant.above_limit_of", {"drive": Text("fan-2", "fan-2"), **params})
            assert kit.drives_of_events("plant.above_limit", **params) == ["fan-2"]
            write(file, FAN_1, FILE_LIMITS, FAN_2)
            (note,) = (await kit.call("configuration.reload"))["notes"]
            assert "fan-1" in note["en"] and "20.0 Hz" in note["en"] and "限值不会使电机减速" in note["zh"]
            await asyncio.sleep(5)
            assert kit.station("fan-1").motor.target_hz == 40.0, "a limit sends nothing by itself"
            await kit.call("drive.set_frequency", drive="fan-1", frequency_hz=20.0)
            await asyncio.sleep(5)
            answer = await kit.call("drive.limits", drive="fan-1", **WIDEST_LIMITS | {"maximum_hz": 20.0})
            assert answer["note"] is None

    run(scenario())


def test_a_lower_limit_also_names_a_drive_that_is_still_ramping_up_below_it(tmp_path: Path) -> None:
    """It was set to 40 Hz and read at 15 Hz: the limit of 30 Hz does not end its acceleration."""

    async def scenario() -> None:
        async with running_service(load(write(tmp_path / "plant.toml", FAN_1))) as kit:
            await asyncio.sleep(2)
            await kit.grant_waivers()
            await kit.call("drive.run", drive="fan-1", frequency_hz=40.0)
            assert kit.station("fan-1").motor.output_hz < 30.0
            answer = await kit.call("drive.limits", drive="fan-1", **WIDEST_LIMITS | {"maximum_hz": 30.0})
            assert "was set to, 40.0 Hz" in answer["note"]["en"]
            assert (await kit.call("drives.get", drive="fan-1"))["above_limit_hz"] == 40.0

    run(scenario())


def test_a_reload_that_changes_its_polls_repeats_no_event_about_limits_of_another_motor(tmp_path: Path) -> None:
    file, store = write(tmp_path / "plant.toml", FAN_1), MemoryStore()
    former = {"model": "c320", "port": "sim://c320@1-3?ramp=2&name=a", "address": 1}

    async def scenario() -> None:
        async with running_service(load(file), store=store) as kit:
            await kit.call("drive.limits", drive="fan-1", **WIDEST_LIMITS | {"maximum_hz": 40.0})
            for lines in ("", "min_poll_interval_s = 2.0\n"):
                write(file, OTHER_FAN_1, lines)
                await kit.call("configuration.reload")
                assert kit.drives_of_events("plant.limits_of_another", **former) == ["fan-1"]

    run(scenario())


def test_a_changed_profile_file_is_not_half_in_force_after_other_poll_periods(tmp_path: Path) -> None:
    """It took the place of the profile of a running drive, limits, registers and all, though only polls had changed."""
    profile = tmp_path / "mine.toml"
    profile.write_text('format = 1\nextends = "c320"\n[limits]\nmaximum_hz = 40.0\n')
    fan = FAN_1.replace('"c320"', '"mine.toml"')
    file = write(tmp_path / "plant.toml", fan)

    async def scenario() -> None:
        async with running_service(load(file)) as kit:
            profile.write_text('format = 1\nextends = "c320"\n[limits]\nmaximum_hz = 45.0\n')
            write(file, fan, "min_poll_interval_s = 2.0\n")
            await kit.call("configuration.reload")
            runtime = kit.service.plant.drives["fan-1"]
            assert runtime.config.min_poll_interval_s == 2.0
            assert (runtime.drive.range_hz[1], runtime.configured_range_hz[1]) == (40.0, 40.0)

    run(scenario())


def test_a_drive_that_ran_at_its_keypad_when_it_answered_last_does_not_leave_the_plant(tmp_path: Path) -> None:
    """Its state is unknown, and this service did not start the drive: a reload removed it, and nothing watched it."""
    file = write(tmp_path / "plant.toml", FAN_1, FAN_2)

    async def scenario() -> None:
        async with running_service(load(file)) as kit:
            await asyncio.sleep(3)
            kit.station("fan-2").keypad_run(20.0)
            await asyncio.sleep(3)
            runtime = kit.service.plant.drives["fan-2"]
            assert runtime.status().state.turning and not runtime.runs_for_service
            port = simulated_bus_of(runtime.bus.port)
            port.unplug()
            await asyncio.sleep(30)
            assert not runtime.status().state.turning
            for parts in ((FAN_1,), (FAN_1, FAN_2.replace("address = 2", "address = 3"))):
                write(file, *parts)
                with pytest.raises(ServiceError) as rejected:
                    await kit.call("configuration.reload")
                assert rejected.value.key == "plant.reload_last_turning"
            write(file, FAN_1, FAN_2, head=HEAD.replace("name=a", "name=other"))
            await kit.call("configuration.reload")
            moved = kit.service.plant.drives["fan-2"]
            assert moved is not runtime and moved.last_known_turning, "behind another adapter it is watched again"

    run(scenario())


def test_a_drive_that_stood_still_when_it_answered_last_may_leave_the_plant(tmp_path: Path) -> None:
    file = write(tmp_path / "plant.toml", FAN_1, FAN_2)

    async def scenario() -> None:
        async with running_service(load(file)) as kit:
            await asyncio.sleep(3)
            kit.simulated_bus("fan-2").unplug()
            await asyncio.sleep(30)
            write(file, FAN_1)
            await kit.call("configuration.reload")
            assert list(kit.service.plant.drives) == ["fan-1"]

    run(scenario())
