"""Fuzz every decoder: ``PYTHONPATH=tests python -m fuzz --runs 1000000 --write`` (pip install atheris; Linux).

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

from verification.report import current_commit

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
REPORT = ROOT / "docs" / "reports" / "atheris.json"
TRIED = ("src/drivebus/protocols", "src/drivebus/protocols/codec.py", "tests/fuzz")


def main() -> int:
    options = argparse.ArgumentParser(prog="python -m fuzz", description=__doc__)
    options.add_argument("names", nargs="*", help="such as dzb100; all without any")
    options.add_argument("--runs", type=int, default=1_000_000)
    options.add_argument("--seconds", type=int, default=0, help="stop each decoder after so long; 0: never")
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--write", action="store_true", help=f"write {REPORT.relative_to(ROOT)}")
    chosen = options.parse_args()
    report = json.loads(REPORT.read_text(encoding="utf-8")) if REPORT.exists() else {"decoders": {}}
    for script in sorted(HERE.glob("fuzz_*.py")):
        name = script.stem.removeprefix("fuzz_").replace("_", "-")
        if not chosen.names or name in chosen.names:
            found = report["decoders"][name] = fuzzed(script, chosen.runs, chosen.seconds, chosen.seed)
            print(name, found, flush=True)
            if chosen.write:
                REPORT.write_text(json.dumps(report, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    return int(any(one["crashes"] for one in report["decoders"].values()))


def fuzzed(script: Path, runs: int, seconds: int, seed: int) -> dict[str, Any]:
    """One harness's figures. ``edges`` and ``features`` are libFuzzer's "cov" and "ft"."""
    began = time.monotonic()
    command = [sys.executable, str(script), f"-runs={runs}", f"-max_total_time={seconds}", f"-seed={seed}"]
    command.append("-print_final_stats=1")
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    last = re.findall(r"cov: (\d+) ft: (\d+) corp: (\d+)/", done.stderr)
    counted = re.search(r"stat::number_of_executed_units: (\d+)", done.stderr)
    edges, features, corpus = map(int, last[-1]) if last else (0, 0, 0)
    crashed = "Uncaught Python exception" in done.stderr or "ERROR: libFuzzer" in done.stderr
    if done.returncode and not crashed:
        raise SystemExit(f"{script.name} was ended from outside ({done.returncode})")
    if crashed:
        print(done.stderr[-3000:], file=sys.stderr)
    return {
        "commit": current_commit(ROOT, *TRIED),
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
