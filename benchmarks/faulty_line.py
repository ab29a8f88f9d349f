"""Answers of a bus on which replies are missing, damaged or late: ``python -m benchmarks.faulty_line``.

drivebus and pymodbus take turns on a bus of 19,200 baud with the same faults from the same seeds. pymodbus has the same
reply timeout and does not retry; it is measured as it is and, "silent", with the silence of 3.5 characters before each
request that Modbus RTU demands. ``polling``: 31 stations; ``awaiting``: one program that awaits one answer after the
other, which waits for the quarantine of a station whose reply is missing or late.
"""

from __future__ import annotations

import argparse
import os
from statistics import median
from typing import Any

from benchmarks.__main__ import current_commit, print_figures
from benchmarks.harness import CStations, Figures, run_client

BAUD = 19_200
DELAY_S = 0.002
PERIOD_S = 0.01
LATE_S = 0.15
KINDS: dict[str, dict[str, Any]] = {
    "none": {},
    "missing": {"missing": 50},
    "damaged": {"damaged": 50},
    "late": {"late": (50, int(1e6 * LATE_S))},
    "mixed": {"missing": 17, "damaged": 17, "late": (16, int(1e6 * LATE_S))},
}
"""Faults a thousand replies."""
PROGRAMS = {"polling": ("drivebus_lines", 31), "awaiting": ("drivebus_transact", 4)}
PEERS = ("pymodbus_async", "pymodbus_async silent")


def answers_per_s(client: str, stations: int, seconds: float, seed: int, faults: dict[str, Any]) -> tuple[float, int]:
    """Return the right answers a second of one turn, and the number of late or wrong replies that it accepted."""
    name, *options = client.split()
    with CStations(baud=BAUD, delay_us=int(1e6 * DELAY_S), seed=seed, **faults) as line:
        found = run_client(name, line.paths, seconds, BAUD, PERIOD_S, DELAY_S, *options, addresses=stations)
    right = found["done"] - found["failed"] - found["wrong"]
    return right / found["wall_s"], found["wrong"]


def compare(program: str, kind: str, seconds: float, rounds: int) -> Figures:
    """Measure the clients in turns; each ratio is the median of those of the rounds."""
    ours, stations = PROGRAMS[program]
    turns = [
        {client: answers_per_s(client, stations, seconds, seed, KINDS[kind]) for client in (ours, *PEERS)}
        for seed in range(1, rounds + 1)
    ]
    rates = {client: round(median(turn[client][0] for turn in turns), 1) for client in (ours, *PEERS)}
    ratios = {peer: round(median(turn[ours][0] / turn[peer][0] for turn in turns), 3) for peer in PEERS}
    late = {client: sum(turn[client][1] for turn in turns) for client in (ours, *PEERS)}
    return {"answers_per_s": rates, "ratio_to": ratios, "late_accepted": late}


def main() -> None:
    options = argparse.ArgumentParser(prog="python -m benchmarks.faulty_line", description=__doc__)
    options.add_argument("--seconds", type=float, default=20.0, help="duration of each client's turn")
    options.add_argument("--rounds", type=int, default=6, help="turns of each client, each with a seed of its own")
    options.add_argument("--program", choices=PROGRAMS, action="append", help="default: both")
    options.add_argument("--kind", choices=KINDS, action="append", help="default: all")
    options.add_argument("--write", action="store_true", help="write docs/reports/faulty-line.json")
    chosen = options.parse_args()
    found: Figures = {"commit": current_commit(), "busy": round(os.getloadavg()[0], 2)}
    found |= {"faults_a_thousand": 50, "late_ms": round(1000 * LATE_S)}
    for program in chosen.program or PROGRAMS:
        found[program] = {kind: compare(program, kind, chosen.seconds, chosen.rounds) for kind in chosen.kind or KINDS}
    print_figures(found, "faulty-line.json", write=chosen.write)


if __name__ == "__main__":
    main()
