"""Output frequency that contradicts the status word: a wrong list of states must not confirm a stop."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Any

import pytest

from drivebus import profiles
from drivebus.bus import Bus
from drivebus.commissioning.profile_simulator import ProfileStation
from drivebus.drives.dialects.status_word import derive_state
from drivebus.drives.drive import Drive
from drivebus.drives.outcome import OutcomeStatus
from drivebus.drives.readings import ReadingPairs
from drivebus.drives.state import DerivedState, DriveState
from drivebus.errors import StartInhibited, StopUnconfirmed, TargetNotReached
from drivebus.profiles.model import DriveProfile
from drivebus.profiles.words import StatusMap
from drivebus.protocols.modbus import ReadRegisters
from drivebus.simulator.bus import SimulatedBus
from drivebus.simulator.motor import Trip
from drivebus.simulator.port import SimPort
from drivebus.testing.virtual_time import run
from drivebus.values import Quality, Reading

MODEL = "dzb200"  # 1 forward, 2 reverse, 3 stopped, 4 fault, 5 not ready; 3001H: output frequency in 0.01 Hz
WRONG_STATES = ["stopped", "fault", "not_ready"]
STALE_HZ = 3900


class DrivenStation(ProfileStation):
    """Simulated drive that can ignore commands, and whose frequency register can keep its value of before a trip."""

    is_deaf = is_stale = False

    def _execute(self, word: int) -> int:
        return 0 if self.is_deaf else super()._execute(word)

    def _signal_word(self, signal: Any) -> int:
        return STALE_HZ if self.is_stale and signal.name == "output_frequency" else super()._signal_word(signal)


def with_status(profile: DriveProfile, **changes: Any) -> DriveProfile:
    """Return the profile with other entries in its status map."""
    assert profile.status is not None
    return replace(profile, status=replace(profile.status, **changes))


def wrong_profile(state: str, **changes: Any) -> DriveProfile:
    """Return a profile whose value 1, forward run, has the name of another state."""
    return with_status(profiles.load(MODEL), values={1: state, 3: "stopped", 4: "fault", 5: "not_ready"}, **changes)


@asynccontextmanager
async def drive_at_39_hz(profile: DriveProfile) -> AsyncIterator[tuple[Drive, DrivenStation, Bus]]:
    """Yield the drive of this profile on a simulated drive of the right one, which runs at 39 Hz."""
    station = DrivenStation(1, profile=profiles.load(MODEL))
    station.set_ramps(4.0, 4.0)
    simulated = SimulatedBus([station], line_quality="clean", seed=7)
    port: Any = SimPort(simulated, simulated.settings, "sim://wrong", "off")
    async with Bus(port) as bus:
        drive = Drive(bus, profile, 1)
        await drive.status()
        station.run_towards(39.0)
        await asyncio.sleep(6)
        await drive.status()
        yield drive, station, bus


@pytest.mark.parametrize("state", WRONG_STATES)
def test_a_stop_is_confirmed_only_once_the_drive_reports_0_hz(state: str) -> None:
    async def scenario() -> None:
        async with drive_at_39_hz(wrong_profile(state)) as (drive, station, _):
            assert station.motor.output_hz == pytest.approx(39.0)
            assert (await drive.stop()).status is OutcomeStatus.CONFIRMED
            assert abs(station.motor.output_hz) < 0.02

    run(scenario())


@pytest.mark.parametrize("state", WRONG_STATES)
def test_a_drive_that_runs_on_at_a_constant_frequency_is_reported_after_two_seconds(state: str) -> None:
    async def scenario() -> None:
        async with drive_at_39_hz(wrong_profile(state)) as (drive, station, _):
            station.is_deaf = True
            begun = asyncio.get_running_loop().time()
            with pytest.raises(StopUnconfirmed) as caught:
                await drive.stop()
            assert asyncio.get_running_loop().time() - begun < 4.0  # no ramp is waited for that the frequency denies
            assert caught.value.outcome.key == "drives.stop_unconfirmed"
            assert caught.value.outcome.params["output_hz"] == 39.0

    run(scenario())


def test_a_status_that_alone_shows_standstill_is_believed_at_any_frequency() -> None:
    async def scenario() -> None:
        async with drive_at_39_hz(wrong_profile("stopped", standstill="status_alone")) as (drive, station, _):
            assert (await drive.stop()).status is OutcomeStatus.CONFIRMED
            assert station.motor.output_hz > 30.0

    run(scenario())


def test_a_stop_reads_no_more_than_before() -> None:
    """Two rounds of status and frequency confirm a stop at standstill, with the contradiction and without it."""

    async def reads(profile: DriveProfile) -> int:
        async with drive_at_39_hz(profile) as (drive, station, bus):
            station.trip(Trip.EXTERNAL)
            await asyncio.sleep(60)
            sent: list[Any] = []
            bus.trace(lambda e: sent.append(e.message) if e.direction == "sent" else None)
            assert (await drive.stop()).status is OutcomeStatus.CONFIRMED
            return sum(isinstance(message, ReadRegisters) for message in sent)

    right = profiles.load(MODEL)
    assert run(reads(right)) == run(reads(with_status(right, standstill="status_alone"))) > 0


def test_a_fault_is_reset_although_the_frequency_of_before_the_trip_is_still_shown() -> None:
    async def scenario() -> None:
        async with drive_at_39_hz(profiles.load(MODEL)) as (drive, station, _):
            station.is_stale = True
            station.trip(Trip.EXTERNAL)
            await asyncio.sleep(20)
            assert (await drive.status()).state is DriveState.DECELERATING
            assert (await drive.reset_fault()).key == "drives.reset_confirmed"
            assert station.motor.trip is None

    run(scenario())


def test_a_reset_that_the_drive_ignores_is_not_confirmed_by_the_frequency_of_before_the_trip() -> None:
    async def scenario() -> None:
        async with drive_at_39_hz(profiles.load(MODEL)) as (drive, station, _):
            station.is_stale = station.is_deaf = True
            station.trip(Trip.EXTERNAL)
            await asyncio.sleep(20)
            with pytest.raises(TargetNotReached, match="still reports fault after the reset"):
                await drive.reset_fault()

    run(scenario())


def test_a_drive_whose_frequency_changes_in_a_fault_is_not_reset() -> None:
    async def scenario() -> None:
        async with drive_at_39_hz(wrong_profile("fault")) as (drive, station, _):
            station.set_ramps(40.0, 40.0)
            station.keypad_stop()
            with pytest.raises(StartInhibited, match="stop it before a reset"):
                await drive.reset_fault()

    run(scenario())


def derived(status: StatusMap, *replies: tuple[float, str, float]) -> DerivedState | None:
    """Return the state after replies of (time, name, value), with frequencies in steps of 0.1 Hz."""
    pairs = ReadingPairs()
    for at, name, value in replies:
        raw = round(value * 10) & 0xFFFF if name == "output_frequency" else int(value)
        found = Reading(value=value, unit="", quality=Quality.GOOD, source_time=at, reason=None, raw=raw)
        pairs.add({name: found})
    return derive_state(status, pairs, (), 0.1)


STOPPED = [(0.0, "state", 0), (1.0, "state", 0)]


@pytest.mark.parametrize(
    ("replies", "state"),
    [
        ([], DriveState.STOPPED),
        ([(0.5, "output_frequency", 39.0), (1.5, "output_frequency", 39.0)], DriveState.DECELERATING),
        ([(0.5, "output_frequency", -39.0), (1.5, "output_frequency", -39.0)], DriveState.DECELERATING),
        ([(0.5, "output_frequency", 39.0), (1.5, "output_frequency", 0.0)], None),
        ([(0.5, "output_frequency", 0.1), (1.5, "output_frequency", 0.1)], DriveState.STOPPED),  # one step is noise
        ([(0.5, "output_frequency", 0.2), (1.5, "output_frequency", 0.2)], DriveState.DECELERATING),
        ([(0.5, "output_frequency", -0.1), (1.5, "output_frequency", -0.1)], DriveState.STOPPED),
        (
            [(-2.0, "output_frequency", 39.0), (-1.0, "output_frequency", 39.0)],
            DriveState.STOPPED,
        ),  # of before the stop
        ([(1.5, "output_frequency", 39.0)], DriveState.STOPPED),  # one reading: nothing follows from it
    ],
)
def test_what_a_frequency_says_of_a_word_without_motion(
    replies: list[tuple[float, str, float]], state: DriveState | None
) -> None:
    status = profiles.load("optidrive_eco").status
    assert status is not None and status.standstill == "status"
    found = derived(status, *STOPPED, *replies)
    assert (found and found.state) == state
    assert found is None or found.by_frequency is (state is DriveState.DECELERATING)


def test_no_included_model_lets_the_status_alone_confirm_a_stop() -> None:
    maps = [profile.status for name in profiles.models() if (profile := profiles.load(name)).status is not None]
    assert len(maps) > 90 and all(status and status.standstill != "status_alone" for status in maps)
