"""Harness of a measurement: builds the C parts, starts the stations, runs a client and collects the figures."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

BENCHMARK_FOLDER = Path(__file__).resolve().parent
BUILD_FOLDER = Path(tempfile.gettempdir()) / "drivebus-benchmarks"
Figures = dict[str, Any]


def build_c_source(source: str, *libraries: str) -> Path:
    """Compile a C file of this folder; needs gcc (and libmodbus-dev for the libmodbus peer)."""
    BUILD_FOLDER.mkdir(exist_ok=True)
    target = BUILD_FOLDER / Path(source).stem
    flags: list[str] = []
    if libraries:
        command = ["pkg-config", "--cflags", "--libs", *libraries]
        flags = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    subprocess.run(["gcc", "-O2", "-o", str(target), str(BENCHMARK_FOLDER / source), *flags], check=True)
    return target


class CStations:
    """Simulated stations (``station.c``) for the time of a ``with``; afterwards ``figures`` holds their counts."""

    def __init__(
        self,
        lines: int = 1,
        *,
        baud: int = 0,
        delay_us: int = 0,
        dead: int = 0,
        late: tuple[int, int] = (0, 0),
        missing: int = 0,
        damaged: int = 0,
        seed: int = 0,
        flat: int = 0,
        record: Path | None = None,
    ) -> None:
        faults = (*late, missing, damaged, seed)
        arguments = (lines, 31, baud, 10, delay_us, dead, *faults, flat, *([record] if record else []))
        self.arguments = [str(argument) for argument in arguments]
        self.paths: list[str] = []
        self.figures: Figures = {}

    def __enter__(self) -> CStations:
        self.process = subprocess.Popen(
            [build_c_source("station.c"), *self.arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self.process.stdout
        while (line := self.process.stdout.readline().strip()) != "ready":
            self.paths.append(line)
        return self

    def __exit__(self, *_: object) -> None:
        rest, _errors = self.process.communicate()
        self.figures = json.loads(rest)


def run_client(
    name: str,
    paths: Sequence[str],
    seconds: float,
    baud: int,
    *more: object,
    addresses: int = 31,
    busy_thread: bool = False,
) -> Figures:
    """Run one client on the buses at ``paths``, with the first ``addresses`` stations of each, and return its figures.

    ``busy_thread``: a second thread of the client computes all the time.
    """
    if name == "libmodbus":
        command: list[str] = [str(build_c_source("clients/libmodbus_client.c", "libmodbus"))]
    else:
        command = [sys.executable, str(BENCHMARK_FOLDER / "clients" / f"{name}.py")]
    arguments = [",".join(paths), str(addresses), str(seconds), str(baud), *(str(part) for part in more)]
    environment = os.environ | ({"BUSY_THREAD": "1"} if busy_thread else {})
    done = subprocess.run([*command, *arguments], env=environment, capture_output=True, text=True, check=False)
    if done.returncode != 0 or not done.stdout:
        raise RuntimeError(f"{name} failed: {done.stderr[-2000:]}")
    return dict(json.loads(done.stdout.strip().splitlines()[-1]))
