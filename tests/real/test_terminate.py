"""SIGTERM: ``drivebus run`` stops the drive that it started and prints the outcome.

The time that this takes is not asserted here; ``python -m benchmarks.stop`` measures it against its goal of 3 s.
"""

from __future__ import annotations

import json
import signal
import subprocess
from collections.abc import Callable
from typing import Any

from fixtures.child_process import SLOW_MACHINE_C320
from real.conftest import Start
from real.recorded_bench import PROCESS_TIMEOUT_S, RecordedPlant, c320, wait_until
from verification.reference.effects import RequestEffect

Plants = Callable[..., RecordedPlant]
MOMENTS: tuple[tuple[str, Callable[[RecordedPlant, int], bool]], ...] = (
    ("the first read is out", lambda plant, line: len(plant.requests(line)) >= 1),
    ("the checks before the start run", lambda plant, line: len(plant.requests(line)) >= 4),
    ("the start is out", lambda plant, line: RequestEffect.MOTION in host_actions(plant, line)),
    ("the motor turns", lambda plant, line: plant.on(line)),
    ("it has run for a while", lambda plant, line: len(host_actions(plant, line, reads_after_the_start=True)) > 6),
)


def host_actions(plant: RecordedPlant, line: int, *, reads_after_the_start: bool = False) -> list[RequestEffect]:
    """Return the effects of the requests on a line in order, without reads or from the start on."""
    effects = [request.effect for request in plant.requests(line)]
    if reads_after_the_start:
        return effects[effects.index(RequestEffect.MOTION) :] if RequestEffect.MOTION in effects else []
    return [effect for effect in effects if effect is not RequestEffect.READ]


def run(started: Start, plant: RecordedPlant, line: int = 0) -> subprocess.Popen[str]:
    return started(
        "run", plant.url(line), "--model", SLOW_MACHINE_C320, "--address", "1", "--frequency", "20", "--json"
    )


def last_document(process: subprocess.Popen[str]) -> dict[str, Any]:
    """Return the last document that the process printed before it ended."""
    out, _ = process.communicate(timeout=PROCESS_TIMEOUT_S)
    last: dict[str, Any] = json.loads(out.splitlines()[-1])
    return last


def test_a_run_that_is_terminated_at_any_moment_stops_its_drive_and_prints_the_outcome(
    plants: Plants, started: Start
) -> None:
    plant = plants(*(c320(ramp_s=0.3, keypad={}) for _ in MOMENTS))
    runs = [run(started, plant, line) for line in range(len(MOMENTS))]
    for line, (moment, come) in enumerate(MOMENTS):
        wait_until(lambda line=line, come=come: come(plant, line), moment)  # type: ignore[misc]
        runs[line].send_signal(signal.SIGTERM)
    results = [last_document(process) for process in runs]
    plant.settle()
    for line, (moment, _) in enumerate(MOMENTS):
        assert runs[line].returncode == 130, moment
        assert (results[line]["event"], results[line]["outcome"]) == ("stopped", "confirmed"), moment
        done = host_actions(plant, line)
        assert not plant.on(line), moment
        assert done[-1] is RequestEffect.STOP and RequestEffect.MOTION not in done[done.index(RequestEffect.STOP) :], (
            moment
        )
    assert [host_actions(plant, line).count(RequestEffect.MOTION) for line in (2, 3, 4)] == [1, 1, 1]


def test_a_run_whose_drive_does_not_answer_the_stop_reports_it_as_not_confirmed(plants: Plants, started: Start) -> None:
    plant = plants(c320(ramp_s=0.3, keypad={}))
    process = run(started, plant)
    wait_until(lambda: plant.on(), "the start")
    plant.order(faults={"silent": True})
    process.send_signal(signal.SIGTERM)
    result = last_document(process)
    assert process.returncode == 4
    assert result["error"]["type"] == "StopUnconfirmed" if "error" in result else result["outcome"] == "unknown"
    assert host_actions(plant, 0).count(RequestEffect.STOP) >= 2, "it is repeated"
    assert plant.on()
