"""The story of every drive: profiles against stations that were written from the sources, and against themselves."""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path

import pytest

from drivebus import profiles
from drivebus.simulator.models.catalog import make_station
from drivebus.simulator.motor import Motor
from drivebus.testing.virtual_time import run
from verification import source_stations
from verification.drive_story import HIDES_FAULTS, LINES, StoryError, play
from verification.source_stations.drives import SOURCE_DRIVES
from verification.source_stations.station import SourceStation

ADDRESS = 3


@pytest.mark.parametrize("line", LINES)
@pytest.mark.parametrize("model", sorted(SOURCE_DRIVES))
def test_a_profile_agrees_with_the_station_of_its_source(model: str, line: str) -> None:
    steps = run(play(profiles.load(model), SourceStation(ADDRESS, SOURCE_DRIVES[model]), line))
    assert {"status", "run forward", "run reverse", "set_frequency", "read output_frequency", "stop"} <= set(steps)
    assert "communication loss" in steps
    assert {"fault", "reset"} <= set(steps) or "status" not in profiles.load(model).capabilities


@pytest.mark.parametrize("model", sorted(set(profiles.models()) - set(SOURCE_DRIVES)))
def test_a_profile_agrees_with_its_simulated_drive(model: str) -> None:
    """Made from the profile itself for most models: it shows that the profile is whole, not that it is right."""
    profile = profiles.load(model)
    steps = run(play(profile, make_station(model, ADDRESS), "clean"))
    assert {"identify", "run forward", "stop", "communication loss"} <= set(steps)
    assert ("fault" in steps) is ("status" in profile.capabilities and model not in HIDES_FAULTS)
    assert ("run reverse" in steps) is ("reverse" in profile.capabilities)
    assert "reset" in steps or "reset_fault" not in profile.capabilities or "fault" not in steps


def test_the_story_finds_a_motor_that_does_not_turn() -> None:
    class Idle(Motor):
        def run(self, target_hz: float) -> None:
            super().run(target_hz / 2)

    with pytest.raises(StoryError, match=r"run forward: 10.0 Hz expected, 5.00 Hz at the motor"):
        run(play(profiles.load("dc1"), SourceStation(ADDRESS, SOURCE_DRIVES["dc1"], motor=Idle()), "clean"))


def test_the_story_finds_a_reading_in_another_unit() -> None:
    drive = SOURCE_DRIVES["dc1"]
    wrong = replace(drive, readings={**drive.readings, 7: lambda station: station.motor.current_a * 100})
    with pytest.raises(StoryError, match="output_current reads"):
        run(play(profiles.load("dc1"), SourceStation(ADDRESS, wrong), "clean"))


def test_the_story_names_the_reason_of_a_request_that_is_never_answered() -> None:
    """A new profile without the capability to read failed with a number of tries only."""
    profile = profiles.load("dc1")
    unreadable = replace(profile, capabilities=profile.capabilities - {"read"})
    with pytest.raises(StoryError, match="not answered in 20 tries: dc1 has no command for this: read"):
        run(play(unreadable, SourceStation(ADDRESS, SOURCE_DRIVES["dc1"]), "clean"))


def test_no_source_station_reads_a_profile() -> None:
    """It would be no evidence: a misread register would be misread at both ends."""
    folder = Path(source_stations.__path__[0])
    imported: set[str] = set()
    for file in sorted(folder.glob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom):
                imported.add(node.module or "")
            elif isinstance(node, ast.Import):
                imported |= {name.name for name in node.names}
    assert any(name.startswith("drivebus.simulator") for name in imported)
    shared = ("drivebus.profiles", "drivebus.drives", "drivebus.commissioning", "drivebus.families", "importlib")
    assert not [name for name in imported if name.startswith(shared)]
