"""The measured command runs and tells the truth of what it saw: ``python -m benchmarks.stop`` (G06, I3, 6.6).

Its figures are for a quiet machine and a report; here only that every stop reached the far end, and the arithmetic.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from peers import need_program

ROOT = Path(__file__).resolve().parents[2]


def test_the_command_that_measures_stops_sees_each_of_them_on_the_far_end() -> None:
    need_program("gcc", "gcc")
    command = [
        sys.executable,
        "-m",
        "benchmarks.stop",
        "--seconds",
        "2",
        "--lines",
        "2",
        "--burners",
        "0",
        "--runs",
        "1",
    ]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    found = json.loads(done.stdout)
    assert found["stops"] > 0 and found["never_seen"] == 0
    assert found["bound_ms"]["of the product's arithmetic"] == found["bound_ms"]["of 5.1, from the manual"]
    machine = found["machine"]
    assert machine["sigterm"]["runs"] == 1 and machine["requests_per_s_answered"] > 0
    assert machine["latency_over_bound"]["p50"] <= machine["latency_over_bound"]["max"]


@pytest.mark.parametrize(
    ("late_s", "met"), [(0.0585, True), (0.0685, True), (0.07, False)], ids=["in time", "10 ms late", "later"]
)
def test_a_stop_that_comes_too_late_is_reported_as_a_goal_that_was_missed(
    late_s: float, met: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(ROOT))
    from benchmarks.latency import Call, Frame, figures_of

    read = Frame(9.999, 10.01, bytes.fromhex("0103300000040000"))
    stop = Frame(10.0 + late_s, 10.1, bytes.fromhex("0106200000020000"))
    other = Frame(10.0 + late_s - 0.01, 10.1, bytes.fromhex("0206200000020000"))
    host = dict.fromkeys(("unconfirmed", "requests_per_s", "request_ms", "occupied_percent", "gap_s"), 0.0)
    host |= {"bound_s": 0.0585 + 80 / 19200, "own_bound_s": 0.0585 + 80 / 19200, "timeout_s": 0.05}
    found = figures_of([Call(0, 1, 10.0, 10.0 + late_s, 1)], {0: [read, other, stop]}, host, 19200)
    assert (found["stops"], found["never_seen"]) == (1, 0)
    assert found["machine"]["goal_met"] is met
    assert found["machine"]["latency_minus_bound_ms"]["max"] == pytest.approx((late_s - 0.0585) * 1e3, abs=1e-3)
    assert found["machine"]["frames_written_between_call_and_stop"] == {1: 1}
    never = figures_of([Call(0, 3, 10.0, 0.0, 0), Call(0, 1, 10.0, 10.0, 0)], {0: [read, stop]}, host, 19200)
    assert never["never_seen"] == 1 and not never["machine"]["goal_met"]
