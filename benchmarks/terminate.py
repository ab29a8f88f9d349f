"""Time from SIGTERM to the stopped event of ``drivebus run``; the goal is 3 s."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from benchmarks.harness import Figures

RUN_COMMAND = [sys.executable, "-m", "drivebus"]
TERMINATE_PROFILE = """\
format = 1
extends = "c320"
model = "slow_adapter"
[options]
setpoint_step.value = "0.01"
[timing]
adapter_latency_s = 0.3
evidence = "user"
"""
"""The simulated drive shares the loaded cores with the other processes, so its replies may be late."""
GOAL_S = 3.0
RAMP_S = 2.0
"""Ramp from 50 Hz; the drive runs at 20 Hz, so 0.8 s of each figure are its deceleration."""


@contextmanager
def simulated_drive() -> Iterator[str]:
    """Run a simulated drive in its own process for the time of a ``with``; yields its port URL."""
    command = [*RUN_COMMAND, "simulate", "--model", "c320", "--address", "1", "--json", "--ramp", str(RAMP_S)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            yield json.loads(process.stdout.readline())["url"]
        finally:
            process.kill()


def termination_times(runs: int) -> Figures:
    """Measure the seconds from the signal to the stopped event and to the end of the process."""
    with tempfile.TemporaryDirectory() as folder, simulated_drive() as url:
        model = Path(folder) / "slow_adapter.toml"
        model.write_text(TERMINATE_PROFILE)
        found = [_one_termination(url, model) for _ in range(runs)]
    ended = [row for row in found if row is not None]
    stops_s = [stopped_s for stopped_s, _, _ in ended]
    return {
        "runs": runs,
        "adapter_allowance_s": 0.3,
        "started": len(ended),
        "confirmed": sum(outcome == "confirmed" for _, _, outcome in ended),
        "slowest_stop_s": round(max(stops_s), 3) if stops_s else None,
        "slowest_exit_s": round(max(end for _, end, _ in ended), 3) if ended else None,
        "goal_met": len(ended) == runs and max(stops_s) <= GOAL_S,
    }


def _one_termination(url: str, model: Path) -> tuple[float, float, str] | None:
    """Start a run, wait for its status event, terminate it. None where the drive did not run."""
    options = ["--model", str(model), "--address", "1", "--frequency", "20", "--wait", "--json"]
    command = [*RUN_COMMAND, "run", url, *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        lines = (json.loads(line) for line in process.stdout)
        if not any(line.get("event") == "status" for line in lines):
            return None
        process.send_signal(signal.SIGTERM)
        begun, stopped_s, outcome = time.monotonic(), 0.0, ""
        for line in lines:
            stopped_s, outcome = time.monotonic() - begun, str(line.get("outcome", "not confirmed"))
        process.wait()
        return stopped_s, time.monotonic() - begun, outcome
