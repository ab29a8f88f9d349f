"""How long ``drivebus run`` takes from SIGTERM to saying that its drive has stopped (6.6: 3 s)."""

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
TERMINATE_PROFILE = """format = 1
extends = "c320"
model = "patient"
[timing]
adapter_latency_s = 0.3
evidence = "user"
"""
"""A C320 whose reply may come 0.3 s late: the simulated drive shares the processor with the commands."""
GOAL_S = 3.0
RAMP_S = 2.0
"""From 50 Hz; the drive runs at 20 Hz, so that 0.8 s of each figure are its own."""


@contextmanager
def simulated_drive() -> Iterator[str]:
    """The LINK of a drive in a process of its own."""
    command = [*RUN_COMMAND, "simulate", "--model", "c320", "--address", "1", "--json", "--ramp", str(RAMP_S)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            yield json.loads(process.stdout.readline())["url"]
        finally:
            process.kill()


def termination_times(runs: int) -> Figures:
    """Seconds from the signal to the last word and to the end of the process, and the words."""
    with tempfile.TemporaryDirectory() as folder, simulated_drive() as url:
        model = Path(folder) / "patient.toml"
        model.write_text(TERMINATE_PROFILE)
        found = [_one_termination(url, model) for _ in range(runs)]
    ended = [one for one in found if one is not None]
    words = [word for word, _, _ in ended]
    return {
        "runs": runs,
        "adapter_allowance_s": 0.3,
        "started": len(ended),
        "confirmed": sum(outcome == "confirmed" for _, _, outcome in ended),
        "slowest_to_its_last_word_s": round(max(words), 3) if words else None,
        "slowest_to_its_end_s": round(max(end for _, end, _ in ended), 3) if ended else None,
        "goal_met": len(ended) == runs and max(words) <= GOAL_S,
    }


def _one_termination(url: str, model: Path) -> tuple[float, float, str] | None:
    """Start, wait until it runs, terminate. None where it never ran."""
    command = [
        *RUN_COMMAND,
        "run",
        url,
        "--model",
        str(model),
        "--address",
        "1",
        "--json",
        "--frequency",
        "20",
        "--wait",
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        lines = (json.loads(line) for line in process.stdout)
        if not any(line.get("event") == "status" for line in lines):
            return None
        process.send_signal(signal.SIGTERM)
        begun, word, outcome = time.monotonic(), 0.0, ""
        for line in lines:
            word, outcome = time.monotonic() - begun, str(line.get("outcome", "not confirmed"))
        process.wait()
        return word, time.monotonic() - begun, outcome
