"""The whole service on a busy machine, its size and its pace: ``python -m benchmarks.service --write`` (six minutes).

A real ``drivebus serve`` with its web process polls full buses whose far end (``station.c``) times each byte;
the last station of each is silent. Drives are stopped at random instants over socket and web; a stop's latency is from
the client's call to its first bit at the far end, and its bound is the one that the service reports.

    normal     200 requests a second over REST and 50 WebSockets that take everything
    loaded     the same, and a burner for each core
    flood      1,000 requests a second, 500 unread WebSockets, slow heads, bodies of 100 MB, JSON bombs
    stop_all   the first broadcast of "stop all", beside the clients of ``normal``

300 drives: ``--lines 10 --stations 30 --phases normal loaded --settle 0``.
``benchmarks.scaling`` measures start, memory and requests with 12 and with 300 simulated drives. ``busy`` is the
machine's load at the start: latencies of a busy machine are upper bounds.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path

from benchmarks.__main__ import PROJECT_FOLDER, current_commit, print_figures
from benchmarks.harness import CStations, Figures
from benchmarks.latency import STOP_GOALS, read_frames
from benchmarks.scaling import measure_sizes
from benchmarks.service_fixture import BenchmarkService, cpu_s, memory_mb, running_service
from benchmarks.stop import raise_priority, running_processes
from benchmarks.wire_analysis import calls_by_interface, lateness_of_stops, poll_intervals

BAUD, DELAY_US = 19_200, 4000
NORMAL = {"websockets": 50, "connections": 8, "requests_per_s": 200}
FLOOD = {"websockets": 500, "connections": 64, "requests_per_s": 1000, "slow_heads": 100}
WEB_MEMORY_MAX_MB = 256
"""Resident memory of the web process, the flood included."""
MIN_POLL_SHARE = 0.95
"""Polls a second in the flood as a share of those in ``normal``."""
PHASES = ("normal", "loaded", "flood", "stop_all")
ROUNDS = 4
"""Repetitions of "stop all"."""


def print_progress(name: str, phase: Figures) -> None:
    """Print the figures of a phase when it ends: all phases together take minutes."""
    print(name, json.dumps(phase), file=sys.stderr, flush=True)


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """Size of the plant, and the phases that are measured; ``seconds`` of stops in each, half of it in the flood."""

    lines: int
    stations: int
    """On each line; the last is silent."""
    seconds: float
    seed: int
    burners: int
    phases: tuple[str, ...]


@contextmanager
def started_client(name: str, *given: object) -> Iterator[Figures]:
    """Run a client for the time of a ``with``, from its "ready" on; afterwards the figures that it printed."""
    words = [sys.executable, "-m", f"benchmarks.clients.{name}", *map(str, given)]
    found: Figures = {}
    with subprocess.Popen(
        words, cwd=PROJECT_FOLDER, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            if process.stdout.readline() != "ready\n":
                raise RuntimeError(f"{name} is not ready")
            yield found
            found |= json.loads(process.communicate()[0])
        finally:
            process.kill()


def run_stop_load(service: BenchmarkService, options: Measurement, seconds: float, rounds: int, calls: Path) -> Figures:
    """Run ``stop_load`` to its end and return its figures."""
    place = service.directory, service.port, options.lines, options.stations
    given = [*place, seconds, rounds, options.seed, calls]
    words = [sys.executable, "-m", "benchmarks.clients.stop_load", *map(str, given)]
    return dict(
        json.loads(subprocess.run(words, cwd=PROJECT_FOLDER, stdout=subprocess.PIPE, text=True, check=True).stdout)
    )


@contextmanager
def measure_usage(service: BenchmarkService, found: Figures) -> Iterator[None]:
    """Add the use of both processes during a ``with`` to ``found``: percent of one core, memory at its end."""
    processes = service.processes
    before, times = {name: cpu_s(pid) for name, pid in processes.items()}, os.times().elapsed
    yield
    took = os.times().elapsed - times
    found["processes"] = {
        name: {"cpu_percent": round(100 * (cpu_s(pid) - before[name]) / took, 1), "memory_mb": memory_mb(pid)}
        for name, pid in processes.items()
    }


def run_phases(folder: Path, service: BenchmarkService, options: Measurement) -> dict[str, Figures]:
    """Run the chosen phases one after the other against one plant and return the clients' figures of each."""
    found: dict[str, Figures] = {}
    place = service.port, options.lines, options.stations
    usual = *place, NORMAL["websockets"], NORMAL["connections"], NORMAL["requests_per_s"]
    for name in options.phases:
        if name in ("normal", "loaded"):
            burners = options.burners if name == "loaded" else 0
            phase: Figures = {"load": NORMAL | ({"burners": burners} if burners else {})}
            with (
                cpu_load(burners),
                started_client("web_load", *usual) as phase["web_load"],
                measure_usage(service, phase),
            ):
                phase["plant"] = run_stop_load(service, options, options.seconds, 0, folder / name)
        elif name == "flood":
            phase = {"load": FLOOD}
            with (
                started_client("flood", service.port, FLOOD["websockets"], FLOOD["slow_heads"]) as phase["others"],
                started_client("web_load", *place, 0, FLOOD["connections"], FLOOD["requests_per_s"]) as phase[
                    "web_load"
                ],
                measure_usage(service, phase),
            ):
                phase["plant"] = run_stop_load(service, options, options.seconds / 2, 0, folder / name)
        else:  # last: silent drives stay in the stop's retries
            phase = {"rounds": ROUNDS}
            with started_client("web_load", *usual) as phase["web_load"]:
                phase["plant"] = run_stop_load(service, options, 0, ROUNDS, folder / name)
        found[name] = phase
        print_progress(name, phase)
    return found


def cpu_load(number: int) -> AbstractContextManager[None]:
    """Run ``number`` processes that only use a core."""
    return running_processes(*([sys.executable, "-c", "while True: pass"] for _ in range(number)))


def with_wire_figures(phases: Mapping[str, Figures], folder: Path, frames_file: Path, stations: int) -> Figures:
    """Add to each phase the latencies and poll intervals that the far end recorded."""
    frames = read_frames(frames_file)
    for name, phase in phases.items():
        plant = phase.pop("plant")
        for way, calls in calls_by_interface(folder / name).items():
            phase[f"by_{way}"] = lateness_of_stops(calls, frames, plant["bound_s"], BAUD)
        phase["lines_occupied_percent"] = round(plant["occupied_percent"], 1)
        if name != "stop_all":
            phase["errors_of_living_drives"] = plant["errors"]
            phase["polls"] = poll_intervals(frames, range(1, stations), (plant["begun"], plant["ended"]))
    return dict(phases)


def measure_stops(options: Measurement) -> Figures:
    """Run the chosen phases on full lines and return their figures with a verdict for each goal."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        record = folder / "record"
        with CStations(
            options.lines, baud=BAUD, delay_us=DELAY_US, dead=options.stations, flat=0x3000, record=record
        ) as stations:
            priority = raise_priority(stations.process.pid)
            with running_service(folder, stations.paths, options.stations, BAUD) as service:
                nice = {name: os.getpriority(os.PRIO_PROCESS, pid) for name, pid in service.processes.items()}
                phases = run_phases(folder, service, options)
        found = with_wire_figures(phases, folder, record, options.stations)
    return {"far_end_runs": priority, "nice": nice, "verdicts": check_goals(found)} | found


def check_goals(found: Mapping[str, Figures]) -> Figures:
    """Return each goal of the measured phases and whether it was met."""
    loads = {"normal": "", "loaded": "all cores loaded, ", "flood": "flood, "}
    ways = {"socket": "the plant's socket", "web": "the web"}
    verdicts: Figures = {
        f"{load}stops over {way}": found[phase][f"by_{interface}"]["goal_met"]
        for phase, load in loads.items()
        if phase in found
        for interface, way in ways.items()
    }
    if "flood" in found and "normal" in found:
        normal, flood = found["normal"], found["flood"]
        poll_share = flood["polls"]["of_a_drive_per_s"] / normal["polls"]["of_a_drive_per_s"]
        most_mb = flood["processes"]["web"]["memory_mb"]["most"]
        verdicts |= {
            f"flood, web process below {WEB_MEMORY_MAX_MB} MB": most_mb < WEB_MEMORY_MAX_MB,
            f"flood, at least {MIN_POLL_SHARE:.0%} of the polls kept": poll_share >= MIN_POLL_SHARE,
        }
    return verdicts


def measure_chosen(options: argparse.Namespace) -> Figures:
    head: Figures = {
        "commit": current_commit(),
        "seed": options.seed,
        "busy": round(os.getloadavg()[0], 2),
        "seconds": options.seconds,
        "lines": options.lines,
        "stations_a_line": options.stations,
        "silent_a_line": 1,
        "line": f"{BAUD} 8N1",
        "cores": os.cpu_count(),
        "burners": options.burners,
        "goals": STOP_GOALS,
    }
    names = ("lines", "stations", "seconds", "seed", "burners", "phases")
    found = head | measure_stops(Measurement(**{name: getattr(options, name) for name in names}))
    return found | {"sizes": measure_sizes(options.settle)}


def main() -> None:
    options = argparse.ArgumentParser(prog="python -m benchmarks.service", description=__doc__)
    options.add_argument("--seconds", type=float, default=50.0, help="of normal stops; half of it in the flood")
    options.add_argument("--lines", type=int, default=8)
    options.add_argument("--stations", type=int, default=8, help="on each line; the last is silent")
    options.add_argument("--phases", nargs="+", choices=PHASES, default=PHASES)
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--burners", type=int, default=os.cpu_count() or 1, help="processes that only use a core")
    options.add_argument("--settle", type=float, default=60.0, help="seconds after which memory is looked at; 0: skip")
    options.add_argument("--write", action="store_true", help="write docs/reports/service.json")
    chosen = options.parse_args()
    print_figures(measure_chosen(chosen), "service.json", write=chosen.write)


if __name__ == "__main__":
    main()
