"""Drives that report running and fault at once: the motor still turns, and a stop is not confirmed."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Any

import pytest

from drivebus import profiles
from drivebus.bus import Bus
from drivebus.commissioning.profile_simulator import ProfileStation
from drivebus.drives.dialects.status_word import derive_state
from drivebus.drives.drive import Drive
from drivebus.drives.outcome import Outcome, OutcomeStatus
from drivebus.drives.readings import ReadingPairs
from drivebus.drives.state import DerivedState, Direction, DriveState
from drivebus.errors import StopUnconfirmed
from drivebus.profiles.model import DriveProfile
from drivebus.profiles.words import StatusMap
from drivebus.simulator.bus import SimulatedBus
from drivebus.simulator.port import SimPort
from drivebus.testing.virtual_time import run
from drivebus.values import Quality, Reading

FORWARD, REVERSE = Direction.FORWARD, Direction.REVERSE
TURNING_IN_FAULT = [
    ("a1000", 0x0081, FORWARD),
    ("v1000", 0x0085, REVERSE),
    ("frenic_ace", 0x0801, FORWARD),
    ("frenic_mini", 0x0802, REVERSE),
    ("ls_m100", 0x000A, FORWARD),
    ("ls_h100", 0x000C, REVERSE),
    ("powerflex_40", 0x0682, REVERSE),
    ("powerflex_400", 0x068A, FORWARD),
    ("hpvfe", 0x068A, FORWARD),
    ("optidrive_e3", 0x0303, None),
    ("optidrive_eco", 0x0003, None),
    ("optidrive_p2", 0x0003, None),
    ("cfw500", 0x8500, FORWARD),
]
"""Models whose status word is a number, a value of it with the bits of a run and of a fault, and its direction."""


class StuckStation(ProfileStation):
    """Simulated drive that acknowledges every command, obeys none and reports a fixed status word."""

    word = 0

    def _status_word(self, status: StatusMap) -> int:
        return self.word

    def _execute(self, word: int) -> int:
        return 0


def stop_of_stuck_drive(profile: DriveProfile, word: int, frequency_hz: float) -> Outcome:
    """Return the outcome of a stop of a drive that runs on and reports this word."""

    async def scenario() -> Outcome:
        station = StuckStation(1, profile=profile)
        station.word = word
        station.set_ramps(2.0, 2.0)
        simulated = SimulatedBus([station], line_quality="clean", seed=7)
        port: Any = SimPort(simulated, simulated.settings, "sim://stuck", "off")
        async with Bus(port) as bus:
            drive = Drive(bus, profile, 1)
            station.run_towards(frequency_hz)
            await asyncio.sleep(5)
            await drive.status()
            try:
                outcome = await drive.stop()
            except StopUnconfirmed as error:
                outcome = error.outcome
        assert station.motor.output_hz == pytest.approx(frequency_hz)
        return outcome

    return run(scenario())


def state_of(profile: DriveProfile, word: int) -> DerivedState | None:
    """Return the state of a drive that reported this word twice, and no frequency."""
    pairs = ReadingPairs()
    for at in (0.0, 1.0):
        pairs.add({"state": Reading(value=word, unit="", quality=Quality.GOOD, source_time=at, reason=None, raw=word)})
    assert profile.status is not None
    return derive_state(replace(profile.status, standstill="status"), pairs, ())


@pytest.mark.parametrize(("model", "word", "direction"), TURNING_IN_FAULT)
def test_a_drive_that_runs_in_a_fault_turns_and_its_fault_is_named(
    model: str, word: int, direction: Direction | None
) -> None:
    found = state_of(profiles.load(model), word)
    assert found is not None and found.state.turning and not found.state.output_off
    assert found.direction is direction
    assert found.fault_code is not None


def test_a_run_without_a_fault_names_none() -> None:
    for model, word in (("frenic_ace", 0x0001), ("ls_m100", 0x0002), ("optidrive_eco", 0x0001), ("cfw500", 0x2500)):
        found = state_of(profiles.load(model), word)
        assert found == DerivedState(DriveState.RUNNING, found and found.direction)


def test_of_a_status_that_counts_no_value_with_motion_is_taken_for_a_fault_as_well() -> None:
    """Jogging is 5 and a fault 4, which share a bit by chance."""
    profile = profiles.load("dzb200")
    assert profile.status is not None
    values = {1: "running_forward", 3: "stopped", 4: "fault", 5: "jogging_forward"}
    counted = replace(profile, status=replace(profile.status, values=values))
    assert state_of(counted, 5) == DerivedState(DriveState.JOGGING, FORWARD)
    assert state_of(counted, 4) != state_of(counted, 5)


def test_a_stop_is_not_confirmed_by_a_fault_while_the_motor_runs_at_40_hz() -> None:
    outcome = stop_of_stuck_drive(profiles.load("frenic_ace"), 0x0801, 40.0)
    assert outcome.status is OutcomeStatus.UNKNOWN
    assert outcome.key == "drives.stop_unconfirmed" and outcome.params["output_hz"] == 40.0
