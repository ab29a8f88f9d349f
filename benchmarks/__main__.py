"""`make bench`: every figure beside its peers in one run; --write writes docs/reports/benchmarks.json and .md."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path

from benchmarks import codecs, master, motors, virtual
from benchmarks.harness import Figures
from benchmarks.report import markdown
from verification import report

PROJECT_FOLDER = Path(__file__).resolve().parents[1]


def current_commit() -> str:
    """Return the measured commit, "-dirty" appended where the tree differs from it."""
    return report.current_commit(PROJECT_FOLDER, "src", "benchmarks") or "unknown"


def print_figures(figures: Figures, report: str, *, write: bool) -> None:
    """Print the figures; where ``write`` is set, also write them to docs/reports/."""
    text = json.dumps(figures, indent=1)
    print(text)
    if write:
        (PROJECT_FOLDER / "docs" / "reports" / report).write_text(text + "\n")


def measure_all(seconds: float, rounds: int, pypy: str | None) -> Figures:
    """Measure all parts one after another, because the machine must be quiet; each part is printed when it is done.

    ``pypy``: interpreter that measures simulated time too.
    """
    parts: dict[str, Callable[[], Figures]] = {
        "cpu": lambda: master.transaction_cpu(seconds, rounds),
        "line": lambda: master.one_bus(2 * seconds),
        "line_115200": lambda: master.one_bus(2 * seconds, baud=115_200),
        "one_dead": lambda: master.one_bus(4 * seconds, dead=31),
        "late": lambda: master.one_bus(2 * seconds, late=(20, 150_000)),
        "busy_thread": lambda: master.one_bus(2 * seconds, busy_thread=True),
        "lines_64": lambda: master.many_buses(2 * seconds, 64),
        "lines_128": lambda: master.many_buses(2 * seconds, 128),
        "lines_128_two_processes": lambda: master.many_buses(2 * seconds, 128, processes=2),
        "codecs": codecs.run_codecs,
        "virtual": virtual.run_virtual_time,
        "motors": motors.run_motors,
    }
    if pypy is not None:
        parts["virtual_pypy"] = lambda: virtual.run_with_pypy(pypy)
    found: Figures = {"commit": current_commit()}
    for name, part in parts.items():
        found[name] = part()
        print(name, json.dumps(found[name]), file=sys.stderr, flush=True)
    return found


def main() -> None:
    options = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    options.add_argument("--seconds", type=float, default=5.0, help="duration of each client's turn")
    options.add_argument("--rounds", type=int, default=5, help="turns of each client in the CPU figure")
    options.add_argument("--pypy", metavar="PYTHON", help="PyPy with drivebus installed: measure simulated time there")
    options.add_argument("--write", action="store_true", help="write docs/reports/ instead of printing only")
    chosen = options.parse_args()
    figures = measure_all(chosen.seconds, chosen.rounds, chosen.pypy)
    print_figures(figures, "benchmarks.json", write=chosen.write)
    if chosen.write:
        (PROJECT_FOLDER / "docs" / "reports" / "benchmarks.md").write_text(markdown(figures))


if __name__ == "__main__":
    main()
