"""Drives with a state chart, against stations written from their manuals: preparation, stops, the state of a ramp."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from typing import Any

import pytest

from drivebus import profiles
from drivebus.bus import Bus
from drivebus.drives.drive import Drive
from drivebus.drives.outcome import OutcomeStatus
from drivebus.drives.state import DriveState
from drivebus.errors import DrivebusError
from drivebus.simulator.bus import SimulatedBus
from drivebus.simulator.motor import Trip
from drivebus.simulator.port import SimPort
from drivebus.testing.virtual_time import run
from verification.drive_story import LINES, play
from verification.source_stations.state_charts import CHART_DRIVES, ChartState, ChartStation

ADDRESS = 3
MODELS = sorted(CHART_DRIVES)
SHOWS_RAMP = (False, True)


@asynccontextmanager
async def bench(model: str, shows_ramp: bool, ramp_s: float = 4.0) -> AsyncIterator[tuple[Drive, ChartStation]]:
    """Yield the drive and its station, whose ramps take ``ramp_s`` from 50 Hz."""
    station = ChartStation(ADDRESS, CHART_DRIVES[model], shows_ramp=shows_ramp)
    station.set_ramps(ramp_s, ramp_s)
    port: Any = SimPort(SimulatedBus([station], station.factory_settings), station.factory_settings, "sim://x", "off")
    profile = profiles.load(model)
    share = profile.setpoint_share
    assert share is not None
    async with Bus(port) as bus:
        options = {"maximum_frequency": 50} if share.maximum is None else None
        yield Drive(bus, profile, ADDRESS, options=options), station


def play_out(scenario: Callable[[], Coroutine[Any, Any, None]]) -> None:
    run(scenario())


@pytest.mark.parametrize("shows_ramp", SHOWS_RAMP)
@pytest.mark.parametrize("line", LINES)
@pytest.mark.parametrize("model", MODELS)
def test_a_profile_agrees_with_the_station_of_its_manual(model: str, line: str, shows_ramp: bool) -> None:
    station = ChartStation(ADDRESS, CHART_DRIVES[model], shows_ramp=shows_ramp)
    steps = run(play(profiles.load(model), station, line))
    assert {"run forward", "set_frequency", "read output_frequency", "stop", "fault", "reset"} <= set(steps)
    assert "communication loss" in steps


@pytest.mark.parametrize("shows_ramp", SHOWS_RAMP)
@pytest.mark.parametrize("model", MODELS)
def test_no_state_and_no_outcome_says_stopped_while_the_motor_ramps_down(model: str, shows_ramp: bool) -> None:
    """The status word may say "ready to switch on" as soon as the ramp begins."""

    async def scenario() -> None:
        async with bench(model, shows_ramp) as (drive, station):
            assert (await drive.run(40.0)).status is OutcomeStatus.CONFIRMED
            await asyncio.sleep(6)
            stop = asyncio.ensure_future(drive.stop())
            seen: set[DriveState] = set()
            while not stop.done() or station.motor.energised:
                await asyncio.sleep(0.1)
                status = await drive.status()
                seen.add(status.state)
                assert status.state is not DriveState.STOPPED or not station.motor.energised
                if stop.done() and not stop.exception() and stop.result().status is OutcomeStatus.CONFIRMED:
                    assert not station.motor.energised
            assert DriveState.DECELERATING in seen or shows_ramp
            assert (await drive.stop()).status is OutcomeStatus.CONFIRMED and not station.motor.energised

    play_out(scenario)


@pytest.mark.parametrize("how", ["stop", "quick_stop"])
@pytest.mark.parametrize("model", MODELS)
def test_a_stop_word_keeps_operation_enabled_so_that_the_motor_brakes(model: str, how: str) -> None:
    """Without bit 3, "inhibit operation", the drive removes its output and the motor coasts."""

    async def scenario() -> None:
        async with bench(model, False) as (drive, station):
            await drive.run(40.0)
            await asyncio.sleep(6)
            stop = asyncio.ensure_future(getattr(drive, how)())
            await asyncio.sleep(0.3)
            assert station.state is (ChartState.OFF1 if how == "stop" else ChartState.OFF3)
            assert station.motor.output_hz > 0, "the motor coasts"
            await stop

    play_out(scenario)


@pytest.mark.parametrize("model", MODELS)
def test_a_motor_that_runs_at_the_keypad_is_not_called_stopped(model: str) -> None:
    async def scenario() -> None:
        async with bench(model, False) as (drive, station):
            station.keypad_run(20.0)
            await asyncio.sleep(4)
            assert (await drive.status()).state is not DriveState.STOPPED
            await drive.stop()
            await asyncio.sleep(4)
            assert (await drive.status()).state is DriveState.STOPPED and not station.motor.energised

    play_out(scenario)


@pytest.mark.parametrize("how", ["coast", "quick_stop"])
@pytest.mark.parametrize("model", MODELS)
def test_after_an_emergency_word_the_drive_is_prepared_again(model: str, how: str) -> None:
    async def scenario() -> None:
        async with bench(model, False) as (drive, station):
            await drive.run(20.0)
            await asyncio.sleep(3)
            await getattr(drive, how)()
            await asyncio.sleep(20)
            await drive.status()
            assert station.state is ChartState.INHIBITED and not station.motor.energised
            assert (await drive.run(10.0)).status is OutcomeStatus.CONFIRMED
            await asyncio.sleep(3)
            await drive.status()
            assert station.motor.output_hz == pytest.approx(10.0, abs=0.1)

    play_out(scenario)


@pytest.mark.parametrize("model", MODELS)
def test_a_second_reset_works_as_the_first(model: str) -> None:
    """The drive resets on the rising edge of bit 7."""

    async def scenario() -> None:
        async with bench(model, False) as (drive, station):
            for _ in range(2):
                station.trip(Trip.OVERLOAD)
                await asyncio.sleep(0.2)
                assert (await drive.reset_fault()).status is OutcomeStatus.CONFIRMED
                assert station.motor.trip is None and not station.motor.energised

    play_out(scenario)


@pytest.mark.parametrize(("register", "word"), [(1000, 1), (1002, 2), (1102, 1), (5304, 1), (9903, 1)])
def test_an_abb_drive_that_would_turn_otherwise_than_asked_is_not_started(register: int, word: int) -> None:
    """Commands or reference from elsewhere, direction reversed, other words, or a maximum in rpm."""

    async def scenario() -> None:
        async with bench("acs550", False) as (drive, station):
            station.keypad_set(register, word)
            with pytest.raises(DrivebusError, match="Set "):
                await drive.run(10.0)
            assert not station.motor.energised and station.setpoint_word == 0

    play_out(scenario)


@pytest.mark.parametrize(("model", "register", "word"), [("acs550", 1104, 1000), ("v20", 15, 10000)])
def test_the_maximum_is_read_before_the_setpoint(model: str, register: int, word: int) -> None:
    """Twice the maximum at the keypad would be twice the speed."""

    async def scenario() -> None:
        async with bench(model, False) as (drive, station):
            station.keypad_set(register, word)
            await drive.run(20.0)
            await asyncio.sleep(6)
            await drive.status()
            assert station.motor.output_hz == pytest.approx(20.0, abs=0.1)

    play_out(scenario)
