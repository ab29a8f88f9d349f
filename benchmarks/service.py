"""The whole service on a busy machine, its size and its pace: ``python -m benchmarks.service --write``.

A real ``drivebus serve``, plant and web process, on full lines whose far end (``station.c``) keeps the time of each
byte; the last station of each line is silent. ``normal``: 200 questions a second over REST and 50 WebSockets that take
everything. ``loaded``: the same, and a burner for each core. ``flood``: 1,000 questions a second, 500 WebSockets that
nobody reads, slow heads, bodies of 100 MB and bombs. The service has the precedence that its systemd unit gives it.
Drives are stopped at random instants over the plant's socket and over the web; a stop's latency is from the client's
call to its first bit as the far end sees it. The bound is the plant's own. ``stop_all`` is the same for the first
broadcast of "stop all". Then (``benchmarks.scaling``) how soon, how large and how quick the service is with 12 and with
300 simulated drives. ``busy`` is the machine's load when it began: latencies of a busy machine are upper bounds. All of
it is on this machine's loopback. Some six minutes.
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
from pathlib import Path

from benchmarks.__main__ import PROJECT_FOLDER, current_commit, print_figures
from benchmarks.harness import CStations, Figures
from benchmarks.latency import STOP_GOALS, read_frames
from benchmarks.scaling import measure_sizes
from benchmarks.service_fixture import BenchmarkService, cpu_s, memory_mb, running_service
from benchmarks.stop import raise_priority, running_processes
from benchmarks.wire_analysis import calls_by_interface, lateness_of_stops, poll_intervals

STATIONS = 8
"""On each line; the last is silent."""
BAUD, DELAY_US = 19_200, 4000
NORMAL = {"websockets": 50, "connections": 8, "requests_per_s": 200}
FLOOD = {"websockets": 500, "connections": 64, "requests_per_s": 1000, "slow_heads": 100}
CAP_MB = 256
"""The web process may hold so much, whatever is done to it."""
KEPT = 0.95
"""So much of the polls of ``normal`` the plant must do in the flood as well."""
ROUNDS = 4
"""Times that everything is stopped."""


def print_progress(name: str, story: Figures) -> None:
    """What there is so far: somebody waits for minutes."""
    print(name, json.dumps(story), file=sys.stderr, flush=True)


@contextmanager
def started_client(name: str, *given: object) -> Iterator[Figures]:
    """A client that is ready, for the time of a ``with``; afterwards what it said."""
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


def run_stop_load(hall: BenchmarkService, lines: int, seconds: float, rounds: int, seed: int, calls: Path) -> Figures:
    """Run it; what it said."""
    given = [hall.directory, hall.port, lines, STATIONS, seconds, rounds, seed, calls]
    words = [sys.executable, "-m", "benchmarks.clients.stop_load", *map(str, given)]
    return dict(
        json.loads(subprocess.run(words, cwd=PROJECT_FOLDER, stdout=subprocess.PIPE, text=True, check=True).stdout)
    )


@contextmanager
def measure_usage(hall: BenchmarkService, found: Figures) -> Iterator[None]:
    """What both processes use meanwhile, as percent of one core, and what they hold at its end."""
    processes = hall.processes
    before, times = {name: cpu_s(pid) for name, pid in processes.items()}, os.times().elapsed
    yield
    took = os.times().elapsed - times
    found["processes"] = {
        name: {"cpu_percent": round(100 * (cpu_s(pid) - before[name]) / took, 1), "memory_mb": memory_mb(pid)}
        for name, pid in processes.items()
    }


def run_phases(
    folder: Path, hall: BenchmarkService, lines: int, seconds: float, seed: int, burners: int
) -> dict[str, Figures]:
    """Everything that is done to one plant, one after the other, as the clients tell it."""
    normal: Figures = {"asked": NORMAL}
    loaded: Figures = {"asked": NORMAL | {"burners": burners}}
    flood: Figures = {"asked": FLOOD}
    stop_all: Figures = {"rounds": ROUNDS}
    place = hall.port, lines, STATIONS
    usual = *place, NORMAL["websockets"], NORMAL["connections"], NORMAL["requests_per_s"]
    for name, story, others in (("normal", normal, 0), ("loaded", loaded, burners)):
        with cpu_load(others), started_client("visitors", *usual) as story["visitors"], measure_usage(hall, story):
            story["plant"] = run_stop_load(hall, lines, seconds, 0, seed, folder / name)
        print_progress(name, story)
    with (
        started_client("flood", hall.port, FLOOD["websockets"], FLOOD["slow_heads"]) as flood["others"],
        started_client("visitors", *place, 0, FLOOD["connections"], FLOOD["requests_per_s"]) as flood["visitors"],
        measure_usage(hall, flood),
    ):
        flood["plant"] = run_stop_load(hall, lines, seconds / 2, 0, seed, folder / "flood")
    print_progress("flood", flood)
    with started_client("visitors", *usual) as stop_all["visitors"]:  # last: silent drives are stopped again and again
        stop_all["plant"] = run_stop_load(hall, lines, 0, ROUNDS, seed, folder / "stop_all")
    print_progress("stop_all", stop_all)
    return {"normal": normal, "loaded": loaded, "flood": flood, "stop_all": stop_all}


def cpu_load(number: int) -> AbstractContextManager[None]:
    """So many processes that only use a core."""
    return running_processes(*([sys.executable, "-c", "while True: pass"] for _ in range(number)))


def with_wire_figures(told: Mapping[str, Figures], folder: Path, frames_file: Path) -> Figures:
    """The stories with what the far end saw of them."""
    frames = read_frames(frames_file)
    for name, story in told.items():
        plant = story.pop("plant")
        for way, calls in calls_by_interface(folder / name).items():
            story[f"by_{way}"] = lateness_of_stops(calls, frames, plant["bound_s"], BAUD)
        story["lines_occupied_percent"] = round(plant["occupied_percent"], 1)
        if name != "stop_all":
            alive = range(1, STATIONS)
            story["errors_of_living_drives"] = plant["errors"]
            story["polls"] = poll_intervals(frames, alive, (plant["begun"], plant["ended"]))
    return dict(told)


def measure_stops(lines: int, seconds: float, seed: int, burners: int) -> Figures:
    """All stories on full lines."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        record = folder / "record"
        with CStations(lines, baud=BAUD, delay_us=DELAY_US, dead=STATIONS, flat=0x3000, record=record) as stations:
            precedence = raise_priority(stations.process.pid)
            with running_service(folder, stations.paths, STATIONS, BAUD) as hall:
                nice = {name: os.getpriority(os.PRIO_PROCESS, pid) for name, pid in hall.processes.items()}
                message = run_phases(folder, hall, lines, seconds, seed, burners)
        found = with_wire_figures(message, folder, record)
    return {"far_end_runs": precedence, "nice": nice, "verdicts": check_goals(found)} | found


def check_goals(found: Mapping[str, Figures]) -> Figures:
    """What was asked for, and whether it was met."""
    normal, flood = found["normal"], found["flood"]
    kept = flood["polls"]["of_a_drive_per_s"] / normal["polls"]["of_a_drive_per_s"]
    most_mb = flood["processes"]["web"]["memory_mb"]["most"]
    return {
        "G06, plant's socket": normal["by_socket"]["goal_met"],
        "G06, web": normal["by_web"]["goal_met"],
        "both cores loaded besides, plant's socket": found["loaded"]["by_socket"]["goal_met"],
        "both cores loaded besides, web": found["loaded"]["by_web"]["goal_met"],
        "S14, stops over the plant's socket": flood["by_socket"]["goal_met"],
        "S14, stops over the web": flood["by_web"]["goal_met"],
        f"S14, web process below {CAP_MB} MB": most_mb < CAP_MB,
        f"S14, at least {KEPT:.0%} of the polls kept": kept >= KEPT,
    }


def measure_chosen(chosen: argparse.Namespace) -> Figures:
    head: Figures = {
        "commit": current_commit(),
        "seed": chosen.seed,
        "busy": round(os.getloadavg()[0], 2),
        "evidence_for": ["G06", "S14"],
        "seconds": chosen.seconds,
        "lines": chosen.lines,
        "stations_a_line": STATIONS,
        "silent_a_line": 1,
        "line": f"{BAUD} 8N1",
        "cores": os.cpu_count(),
        "burners": chosen.burners,
        "goals": STOP_GOALS,
    }
    found = head | measure_stops(chosen.lines, chosen.seconds, chosen.seed, chosen.burners)
    return found | {"sizes": measure_sizes(chosen.settle)}


def main() -> None:
    options = argparse.ArgumentParser(prog="python -m benchmarks.service", description=__doc__)
    options.add_argument("--seconds", type=float, default=50.0, help="of normal stops; half of it in the flood")
    options.add_argument("--lines", type=int, default=8)
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--burners", type=int, default=os.cpu_count() or 1, help="processes that only use a core")
    options.add_argument("--settle", type=float, default=60.0, help="seconds after which memory is looked at; 0: skip")
    options.add_argument("--write", action="store_true", help="write docs/reports/service.json")
    chosen = options.parse_args()
    print_figures(measure_chosen(chosen), "service.json", chosen.write)


if __name__ == "__main__":
    main()
