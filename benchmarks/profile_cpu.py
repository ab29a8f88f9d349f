"""CPU profile of one process that polls a bus as fast as it can; ``--write`` writes docs/reports/profile.json.

The profiler adds its own cost to every call, so packages of many small functions look more expensive than they are:
the shares show where to look, the benchmarks show the gain.
"""

from __future__ import annotations

import argparse
import asyncio
import time
from collections import Counter
from cProfile import Profile
from pathlib import Path
from typing import Any

from benchmarks.__main__ import current_commit, print_figures
from benchmarks.clients.station_configs import station_config
from benchmarks.harness import CStations, Figures
from benchmarks.master import UNPACED_BAUD, UNPACED_PERIOD_S
from benchmarks.virtual import STATIONS
from drivebus.bus import Bus
from drivebus.bus.messages import BusResult
from drivebus.bus.prepared_request import Poll
from drivebus.ports import open_port
from drivebus.protocols.modbus import ModbusRtuCodec, ReadRegisters

SYSTEM_CALLS = ("posix.", "select.", "fcntl.", "timerfd")
"""Built-in functions that are system calls."""
SHOWN = 15


def profile_run(seconds: float) -> Figures:
    """Return the shares of CPU time by package and function; a built-in function counts for its caller's package."""
    profile = Profile(time.process_time)
    with CStations() as stations:
        done = asyncio.run(_poll(stations.paths[0], seconds, profile))
    packages, functions = shares(profile)
    return {"transactions": done, "packages_percent": packages, "functions_percent": functions}


async def _poll(path: str, seconds: float, profile: Profile) -> int:
    """Poll four registers of each of 31 stations; returns the number of replies while profiled."""
    done, codec = 0, ModbusRtuCodec()

    def sink(answer: BusResult) -> None:
        nonlocal done
        done += answer.error is None

    async with Bus(open_port(path, baud=UNPACED_BAUD, format="8N1", echo="off")) as bus:
        for address in range(1, STATIONS + 1):
            bus.add_station(station_config(address, codec, 0.002))
            bus.start_polling(address, [Poll(ReadRegisters(address, address, 4), UNPACED_PERIOD_S)], sink)
        await asyncio.sleep(1.0)
        done = 0
        profile.enable()
        await asyncio.sleep(seconds)
        profile.disable()
    return done


def shares(profile: Profile) -> tuple[dict[str, float], dict[str, float]]:
    """Return the percentage of CPU time of each package, and of the most expensive functions."""
    packages, functions = Counter[str](), Counter[str]()
    profile.create_stats()
    found: dict[Any, Any] = profile.stats
    for (file, _, name), (_, _, own_s, _, callers) in found.items():
        if file != "~":
            packages[package_of(file)] += own_s
            functions[f"{'/'.join(Path(file).parts[-2:])}:{name}"] += own_s
        elif any(part in name for part in SYSTEM_CALLS):
            packages["operating system"] += own_s
            functions[name] += own_s
        else:
            for (caller, _, _), (*_, by_it_s, _) in callers.items():
                packages[package_of(caller)] += by_it_s
    return _percent(packages, len(packages)), _percent(functions, SHOWN, sum(packages.values()))


def package_of(file: str) -> str:
    """Return the package of a file: ``drivebus.bus`` and so on, ``asyncio`` or ``other``."""
    parts = Path(file).parts
    if "drivebus" in parts and parts[-1] != "drivebus":
        after = parts[len(parts) - parts[::-1].index("drivebus") :]
        return "drivebus." + (after[0] if len(after) > 1 else Path(after[0]).stem)
    return "asyncio" if "asyncio" in parts else "other"


def _percent(times: Counter[str], most: int, whole_s: float | None = None) -> dict[str, float]:
    whole = sum(times.values()) if whole_s is None else whole_s
    return {name: round(100 * own_s / whole, 1) for name, own_s in times.most_common(most)}


def main() -> None:
    options = argparse.ArgumentParser(prog="python -m benchmarks.profile_cpu", description=__doc__)
    options.add_argument("--seconds", type=float, default=10.0, help="of polling")
    options.add_argument("--write", action="store_true", help="write docs/reports/profile.json")
    chosen = options.parse_args()
    figures = {"commit": current_commit(), **profile_run(chosen.seconds)}
    print_figures(figures, "profile.json", write=chosen.write)


if __name__ == "__main__":
    main()
