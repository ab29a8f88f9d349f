"""Latency of a stop in a busy process on a busy machine: ``python -m benchmarks.stop --write``.

The buses are full, the last station of each is silent, and the far end (``station.c``) keeps the time of each byte. The
loop answers 200 other requests a second, beside a burner for each core. A stop's latency is from the call of
``Drive.stop`` to its first bit at the far end, the kernel's pty included; ``benchmarks.terminate`` then ends runs with
SIGTERM.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from benchmarks.__main__ import current_commit, print_figures
from benchmarks.harness import BENCHMARK_FOLDER, CStations, Figures
from benchmarks.latency import figures_of, read_calls, read_frames
from benchmarks.terminate import termination_times

STATIONS = 8
"""On each line; the last is silent."""
DELAY_US = 4000
"""VC660's factory reply delay, F06.06."""
REQUESTS_PER_S = 200


@contextmanager
def running_processes(*commands: list[str]) -> Iterator[None]:
    """Run processes for the time of a ``with``."""
    children = [subprocess.Popen(command, stdout=subprocess.DEVNULL) for command in commands]
    try:
        yield
    finally:
        for child in children:
            child.kill()
            child.wait()


def raise_priority(pid: int) -> str:
    """Raise the priority of a process as far as this user may; returns how far that was."""
    try:
        os.sched_setscheduler(pid, os.SCHED_FIFO, os.sched_param(1))
        return "SCHED_FIFO"
    except OSError:
        pass
    try:
        os.setpriority(os.PRIO_PROCESS, pid, -15)
        return "nice -15"
    except OSError:
        return "default"


def measure_host_stops(seconds: float, lines: int, baud: int, seed: int) -> Figures:
    """Run host, stations and other work; returns the figures of the stops that the far end recorded."""
    with tempfile.TemporaryDirectory() as folder:
        record, calls = Path(folder) / "record", Path(folder) / "calls"
        with CStations(lines, baud=baud, delay_us=DELAY_US, dead=STATIONS, flat=0x3000, record=record) as stations:
            priority = raise_priority(stations.process.pid)
            arguments = [",".join(stations.paths), STATIONS, round(seconds), baud, STATIONS, seed, calls]
            host = subprocess.Popen(
                [sys.executable, "-m", "benchmarks.clients.stop_host", *map(str, arguments)],
                cwd=BENCHMARK_FOLDER.parent,
                stdout=subprocess.PIPE,
                text=True,
            )
            assert host.stdout is not None
            port = json.loads(host.stdout.readline())["port"]
            with running_processes(
                [sys.executable, str(BENCHMARK_FOLDER / "clients" / "requests.py"), str(port), str(REQUESTS_PER_S)]
            ):
                rest, _ = host.communicate()
        if host.returncode != 0:
            raise RuntimeError(f"the host ended with {host.returncode}")
        found = figures_of(read_calls(calls), read_frames(record), json.loads(rest), baud)
        found["machine"]["far_end_runs"] = priority
        return found


def measure_runs(seconds: float, lines: int, baud: int, seed: int, burners: int, runs: int) -> Figures:
    """Measure stops and terminations with the cores loaded all the time."""
    with running_processes(*([sys.executable, "-c", "while True: pass"] for _ in range(burners))):
        found = measure_host_stops(seconds, lines, baud, seed)
        ended = {"sigterm": termination_times(runs)} if runs else {}
    machine = found.pop("machine") | {"cores": os.cpu_count(), "burners": burners} | ended
    settings = {
        "seconds": seconds,
        "lines": lines,
        "stations_a_line": STATIONS,
        "silent_a_line": 1,
        "line": f"{baud} 8N1",
    }
    work = {
        "requests_per_s": REQUESTS_PER_S,
        "content": "4 KiB hashed, 60 rows of JSON made and sent, on the same loop",
    }
    head = {"commit": current_commit(), "seed": seed, "evidence_for": ["I3"]}
    return head | settings | {"other_work": work} | found | {"machine": machine}


def main() -> None:
    options = argparse.ArgumentParser(prog="python -m benchmarks.stop", description=__doc__)
    options.add_argument("--seconds", type=float, default=120.0)
    options.add_argument("--lines", type=int, default=16)
    options.add_argument("--baud", type=int, default=19_200)
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--burners", type=int, default=os.cpu_count() or 1, help="processes that only use a core")
    options.add_argument("--runs", type=int, default=20, help="runs that are ended with SIGTERM")
    options.add_argument("--write", action="store_true", help="write docs/reports/real-stop.json too")
    chosen = options.parse_args()
    figures = measure_runs(chosen.seconds, chosen.lines, chosen.baud, chosen.seed, chosen.burners, chosen.runs)
    print_figures(figures, "real-stop.json", write=chosen.write)


if __name__ == "__main__":
    main()
