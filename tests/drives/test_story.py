"""The story of every drive: profiles against stations that were written from the sources, and against themselves."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from drivebus import profiles
from drivebus.testing.virtual_time import run
from verification import source_stations
from verification.drive_story import LINES, play
from verification.source_stations.drives import SOURCE_DRIVES
from verification.source_stations.station import SourceStation

ADDRESS = 3


@pytest.mark.parametrize("line", LINES)
@pytest.mark.parametrize("model", sorted(SOURCE_DRIVES))
def test_a_profile_agrees_with_the_station_of_its_source(model: str, line: str) -> None:
    steps = run(play(profiles.load(model), SourceStation(ADDRESS, SOURCE_DRIVES[model]), line))
    assert {"status", "run forward", "run reverse", "set_frequency", "read output_frequency", "stop"} <= set(steps)
    assert {"fault", "reset", "communication loss"} <= set(steps)


def test_no_source_station_reads_a_profile() -> None:
    """It would be no witness: a misread register would be misread at both ends."""
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
