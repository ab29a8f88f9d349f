"""Start-up time of ``drivebus --help`` beside an empty click program: ``python -m benchmarks.startup``.

The two run in turns, so that other load affects both alike; the goal is a ratio of at most 1.5.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

EMPTY_CLICK_PROGRAM = """\
import click


@click.group()
def cli() -> None:
    "An empty program."


@cli.command()
def nothing() -> None:
    "Does nothing."


cli()
"""
DRIVEBUS_PROGRAM = "from drivebus.cli.main import main\nmain()\n"
ROUNDS = 40


def run_startup() -> dict[str, float]:
    """Return the medians in milliseconds and their ratio."""
    with tempfile.TemporaryDirectory() as folder:
        programs = {"empty_click": Path(folder, "empty.py"), "drivebus": Path(folder, "ours.py")}
        programs["empty_click"].write_text(EMPTY_CLICK_PROGRAM)
        programs["drivebus"].write_text(DRIVEBUS_PROGRAM)
        taken: dict[str, list[float]] = {name: [] for name in programs}
        for _ in range(ROUNDS):
            for name, file in programs.items():
                begun = time.perf_counter()
                subprocess.run([sys.executable, str(file), "--help"], stdout=subprocess.DEVNULL, check=True)
                taken[name].append((time.perf_counter() - begun) * 1000.0)
    figures = {f"{name}_ms": round(statistics.median(times), 1) for name, times in taken.items()}
    return figures | {"ratio": round(figures["drivebus_ms"] / figures["empty_click_ms"], 2)}


if __name__ == "__main__":
    print(run_startup())
