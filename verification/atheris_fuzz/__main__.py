"""Fuzz every decoder: ``make fuzz ARGS="--runs 1000000 --write"`` (pip install atheris first; Linux).

Writes docs/reports/atheris.json.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

from verification.atheris_fuzz.targets import ATHERIS_TARGETS
from verification.report import current_commit

ROOT = Path(__file__).resolve().parents[2]
RUN_MODULE = "verification.atheris_fuzz.run"
REPORT = ROOT / "docs" / "reports" / "atheris.json"
FUZZED_SOURCES = ("src/drivebus/protocols", "verification/atheris_fuzz")


def main() -> int:
    options = argparse.ArgumentParser(prog="python -m verification.atheris_fuzz", description=__doc__)
    options.add_argument("names", nargs="*", metavar="NAME", help="decoders such as dzb100; default: all")
    options.add_argument("--runs", type=int, default=1_000_000)
    options.add_argument("--seconds", type=int, default=0, help="time limit of each decoder; 0: none")
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--write", action="store_true", help=f"write {REPORT.relative_to(ROOT)}")
    chosen = options.parse_args()
    if unknown := set(chosen.names) - set(ATHERIS_TARGETS):
        options.error(f"unknown decoder: {', '.join(sorted(unknown))}")
    report = json.loads(REPORT.read_text(encoding="utf-8")) if REPORT.exists() else {"decoders": {}}
    for name in chosen.names or sorted(ATHERIS_TARGETS):
        found = report["decoders"][name] = fuzz(name, chosen.runs, chosen.seconds, chosen.seed)
        print(name, found, flush=True)
        if chosen.write:
            REPORT.write_text(json.dumps(report, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    return int(any(decoder["crashes"] for decoder in report["decoders"].values()))


def fuzz(name: str, runs: int, seconds: int, seed: int) -> dict[str, Any]:
    """Fuzz one decoder and return its figures; ``edges`` and ``features`` are libFuzzer's "cov" and "ft"."""
    began = time.monotonic()
    command = [sys.executable, "-m", RUN_MODULE, name, f"-runs={runs}", f"-max_total_time={seconds}", f"-seed={seed}"]
    command.append("-print_final_stats=1")
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    last = re.findall(r"cov: (\d+) ft: (\d+) corp: (\d+)/", done.stderr)
    counted = re.search(r"stat::number_of_executed_units: (\d+)", done.stderr)
    edges, features, corpus = map(int, last[-1]) if last else (0, 0, 0)
    crashed = "Uncaught Python exception" in done.stderr or "ERROR: libFuzzer" in done.stderr
    if done.returncode and not crashed:
        raise SystemExit(f"{name} was killed ({done.returncode})")
    if crashed:
        print(done.stderr[-3000:], file=sys.stderr)
    return {
        "commit": current_commit(ROOT, *FUZZED_SOURCES),
        "tool": f"atheris {version('atheris')}",
        "python": sys.version.split()[0],
        "seed": seed,
        "runs": int(counted[1]) if counted else 0,
        "seconds": round(time.monotonic() - began),
        "edges": edges,
        "features": features,
        "corpus": corpus,
        "crashes": int(crashed),
    }


if __name__ == "__main__":
    sys.exit(main())
