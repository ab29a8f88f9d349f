"""Standstill of a drive whose status word drops its run bit at the stop, while the motor still ramps down."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from drivebus import profiles
from drivebus.drives import create_dialect
from drivebus.drives.dialects.status_word import derive_state
from drivebus.drives.outcome import OutcomeStatus
from drivebus.drives.readings import ReadingPairs
from drivebus.drives.state import DerivedState, DriveState
from drivebus.errors import ProfileError
from drivebus.testing.virtual_time import run
from drivebus.values import Quality, Reading
from drives.test_start_preparation import DRIVECOM, bench, load

BY_FREQUENCY = DRIVECOM.replace("mask = 0x006F\nvalues", 'standstill = "output_frequency"\nmask = 0x006F\nvalues')
READY, ENABLED, FAULT = 0x23, 0x27, 0x08


@pytest.fixture(name="profile")
def load_by_frequency(tmp_path: Path) -> profiles.DriveProfile:
    return load(tmp_path, BY_FREQUENCY)


def reading(raw: int, at: float) -> Reading:
    return Reading(value=raw, unit="", quality=Quality.GOOD, source_time=at, reason=None, raw=raw)


def derived(profile: profiles.DriveProfile, *replies: tuple[float, str, int]) -> DerivedState | None:
    """Return the state after replies of (time, name, raw)."""
    pairs = ReadingPairs()
    for at, name, raw in replies:
        pairs.add({name: reading(raw, at)})
    assert profile.status is not None
    return derive_state(profile.status, pairs, ())


def words(*raw: int) -> list[tuple[float, str, int]]:
    return [(float(at), "state", word) for at, word in enumerate(raw)]


def outputs(*raw: int, since: float = 0.5) -> list[tuple[float, str, int]]:
    return [(since + at, "output_frequency", hz) for at, hz in enumerate(raw)]


def test_a_stop_is_confirmed_at_0_hz_and_not_when_the_run_bit_falls(profile: profiles.DriveProfile) -> None:
    async def scenario() -> None:
        async with bench(profile) as (drive, station, _):
            await drive.run(20.0)
            await asyncio.sleep(3)
            begun = asyncio.get_running_loop().time()
            assert (await drive.stop()).status is OutcomeStatus.CONFIRMED
            assert station.motor.output_hz == 0.0 and not station.motor.energised
            assert asyncio.get_running_loop().time() - begun > 0.3  # 20 Hz at 1 s from 50 Hz

    run(scenario())


def test_the_monitor_shows_a_ramp_down_that_the_word_does_not(profile: profiles.DriveProfile) -> None:
    seen: list[DriveState] = []

    async def scenario() -> None:
        async with bench(profile) as (drive, station, _):
            with drive.monitor(on_change=lambda status: seen.append(status.state)):
                await drive.run(20.0)
                await asyncio.sleep(3)
                station.set_ramps(1.0, 10.0)
                await drive.stop(wait=False)
                while station.motor.energised:
                    assert seen[-1] is not DriveState.STOPPED
                    await asyncio.sleep(0.05)
                await asyncio.sleep(3)

    run(scenario())
    assert DriveState.DECELERATING in seen and seen[-1] is DriveState.STOPPED


@pytest.mark.parametrize(
    ("replies", "state"),
    [
        ([*words(READY, READY), *outputs(120, 80)], DriveState.DECELERATING),
        ([*words(READY, READY), *outputs(0, 0)], DriveState.STOPPED),
        ([*words(ENABLED, ENABLED), *outputs(0, 0)], DriveState.RUNNING),
        ([*words(ENABLED, ENABLED)], DriveState.RUNNING),
        ([*words(READY, READY), *outputs(0)], None),  # one frequency: a damaged reply may look like 0 Hz
        ([*words(READY, READY), *outputs(80, 0)], None),
        ([*words(READY, READY), *outputs(0, 0, since=-9.0)], None),  # read before the start whose stop the word shows
        ([*words(FAULT, FAULT), *outputs(120, 80)], DriveState.DECELERATING),  # a fault whose reaction is a ramp
        ([*words(FAULT, FAULT), *outputs(0, 0)], DriveState.FAULT),
    ],
)
def test_the_state_follows_from_word_and_frequency(
    profile: profiles.DriveProfile, replies: list[tuple[float, str, int]], state: DriveState | None
) -> None:
    found = derived(profile, *replies)
    assert (found and found.state) == state
    if found is not None and replies[0][2] == FAULT:
        assert found.fault_code is not None  # named while the drive still turns


def test_a_profile_needs_the_signal_that_shows_standstill(tmp_path: Path) -> None:
    with pytest.raises(ProfileError, match=r"standstill.*\[signals\.output_frequency\]"):
        load(tmp_path, BY_FREQUENCY.replace("[signals.output_frequency]", "[signals.output_speed]"))


def test_speed_0_shows_standstill_where_the_drive_reports_no_frequency() -> None:
    """The source of the H2A does not say whether its state lasts until the motor stands."""
    profile, running, idle = profiles.load("huanyang_h2a"), 1, 3
    assert derived(profile, *words(idle, idle)) is None, "the speed was not read"
    for speeds, state in (((700, 300), DriveState.DECELERATING), ((0, 0), DriveState.STOPPED)):
        replies = [(at, "output_speed", speed) for at, _, speed in outputs(*speeds)]
        found = derived(profile, *words(idle, idle), *replies)
        assert found is not None and found.state is state
    found = derived(profile, *words(running, running))
    assert found is not None and found.state is DriveState.RUNNING
    dialect = create_dialect(profile, 1)
    assert ("holding", 0x700C) in [("holding", read.register) for read in dialect.state_reads()]


@pytest.mark.parametrize("model", ["vfd_f", "vfd_el", "vfd_e"])
def test_frequency_0_shows_standstill_where_the_status_bits_come_from_another_model(model: str) -> None:
    """The page of the VFD-F manual with these bits was not seen, and a copy of the drive prints them reversed."""
    profile = profiles.load(model)
    assert derived(profile, *words(0, 0)) is None, "the output frequency was not read"
    for frequencies, state in (((3000, 2900), DriveState.DECELERATING), ((0, 0), DriveState.STOPPED)):
        found = derived(profile, *words(0, 0), *outputs(*frequencies))
        assert found is not None and found.state is state


def status_is_borrowed(profile: profiles.DriveProfile) -> bool:
    found = profile.evidence.get("status")
    return found is not None and found.kind == "sister"


def test_no_status_word_known_from_a_sister_model_alone_confirms_a_stop() -> None:
    """Another maker's copy may use other bits, and a turning motor would be reported as stopped."""
    borrowed = [profile for profile in map(profiles.load, profiles.models()) if status_is_borrowed(profile)]
    assert len(borrowed) > 10
    alone = [profile.model for profile in borrowed if profile.status.standstill == "status"]
    assert alone == ["v1000"], "the V1000 has no signal of its output frequency"
