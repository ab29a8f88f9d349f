"""SIGTERM: a process stops what it started, and says so. RELIABILITY 6.6.

How long that takes is measured, not asserted: ``python -m benchmarks.stop`` holds it to 3 s.
"""

from __future__ import annotations

import json
import signal
import subprocess
from collections.abc import Callable
from typing import Any

from drivebus.lab.manual import Does
from real.conftest import Start
from real.witness import PATIENCE_S, Plant, c320, patient, until

Plants = Callable[..., Plant]
MOMENTS: tuple[tuple[str, Callable[[Plant, int], bool]], ...] = (
    ("the first read is out", lambda plant, line: len(plant.requests(line)) >= 1),
    ("it is being looked at", lambda plant, line: len(plant.requests(line)) >= 4),
    ("the start is out", lambda plant, line: Does.MOVE in acts(plant, line)),
    ("the motor turns", lambda plant, line: plant.on(line)),
    ("it has run for a while", lambda plant, line: len(acts(plant, line, reads_after_the_start=True)) > 6),
)


def acts(plant: Plant, line: int, *, reads_after_the_start: bool = False) -> list[Does]:
    """What hosts had the drive do, in order."""
    all_of_them = [one.does for one in plant.requests(line)]
    if reads_after_the_start:
        return all_of_them[all_of_them.index(Does.MOVE) :] if Does.MOVE in all_of_them else []
    return [one for one in all_of_them if one is not Does.READ]


def run(started: Start, plant: Plant, line: int = 0) -> subprocess.Popen[str]:
    model = patient(plant.record.parent)
    return started("run", plant.url(line), "--model", model, "--address", "1", "--frequency", "20", "--json")


def told(process: subprocess.Popen[str]) -> dict[str, Any]:
    """The last document that it printed before it ended."""
    out, _ = process.communicate(timeout=PATIENCE_S)
    last: dict[str, Any] = json.loads(out.splitlines()[-1])
    return last


def test_a_run_that_is_told_to_terminate_at_any_moment_stops_its_drive_and_says_so(
    plants: Plants, started: Start
) -> None:
    plant = plants(*(c320(ramp_s=0.3, keypad={}) for _ in MOMENTS))
    runs = [run(started, plant, line) for line in range(len(MOMENTS))]
    for line, (moment, come) in enumerate(MOMENTS):
        until(lambda line=line, come=come: come(plant, line), moment)  # type: ignore[misc]
        runs[line].send_signal(signal.SIGTERM)
    said = [told(process) for process in runs]
    plant.settle()
    for line, (moment, _) in enumerate(MOMENTS):
        assert runs[line].returncode == 130, moment
        assert (said[line]["event"], said[line]["outcome"]) == ("stopped", "confirmed"), moment
        done = acts(plant, line)
        assert not plant.on(line), moment
        assert done[-1] is Does.STOP and Does.MOVE not in done[done.index(Does.STOP) :], moment
    assert [acts(plant, line).count(Does.MOVE) for line in (2, 3, 4)] == [1, 1, 1]


def test_a_run_whose_drive_does_not_answer_the_stop_says_that_it_is_not_confirmed(
    plants: Plants, started: Start
) -> None:
    plant = plants(c320(ramp_s=0.3, keypad={}))
    process = run(started, plant)
    until(lambda: plant.on(), "the start")
    plant.order(faults={"silent": True})
    process.send_signal(signal.SIGTERM)
    said = told(process)
    assert process.returncode == 4
    assert said["error"]["type"] == "StopUnconfirmed" if "error" in said else said["outcome"] == "unknown"
    assert acts(plant, 0).count(Does.STOP) >= 2, "it is repeated"
    assert plant.on()
