"""Where the processor's time goes while one process polls a line as fast as it goes; writes docs/reports/profile.json.

The profiler's own cost falls on every call, so rooms of many small functions look somewhat dearer than they are: the
shares say where to look, the benchmark says what is won.
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
from benchmarks.clients.links import link
from benchmarks.harness import CStations, Figures
from benchmarks.master import UNPACED_BAUD, UNPACED_PERIOD_S
from benchmarks.virtual import STATIONS
from drivebus.bus import Bus
from drivebus.bus.messages import BusResult
from drivebus.bus.prepared_request import Poll
from drivebus.ports import open_port
from drivebus.protocols.modbus import ModbusRtuCodec, ReadRegisters

SYSTEM_CALLS = ("posix.", "select.", "fcntl.", "timerfd")
"""Built-in functions that ask the operating system."""
SHOWN = 15


def profile_run(seconds: float) -> Figures:
    """Shares of the time, by room and by function; built-in functions count for the room that calls them."""
    profile = Profile(time.process_time)
    with CStations() as stations:
        done = asyncio.run(_poll(stations.paths[0], seconds, profile))
    rooms, functions = shares(profile)
    return {"transactions": done, "rooms_percent": rooms, "functions_percent": functions}


async def _poll(path: str, seconds: float, profile: Profile) -> int:
    """31 stations, four registers each; how many answers came while it was watched."""
    done, codec = 0, ModbusRtuCodec()

    def sink(answer: BusResult) -> None:
        nonlocal done
        done += answer.error is None

    async with Bus(open_port(path, baud=UNPACED_BAUD, format="8N1", echo="off")) as bus:
        for address in range(1, STATIONS + 1):
            bus.add_station(link(address, codec, 0.002))
            bus.start_polling(address, [Poll(ReadRegisters(address, address, 4), UNPACED_PERIOD_S)], sink)
        await asyncio.sleep(1.0)
        done = 0
        profile.enable()
        await asyncio.sleep(seconds)
        profile.disable()
    return done


def shares(profile: Profile) -> tuple[dict[str, float], dict[str, float]]:
    """Percent of the time: of rooms, and of the dearest functions."""
    rooms, functions = Counter[str](), Counter[str]()
    profile.create_stats()
    found: dict[Any, Any] = profile.stats
    for (file, _, name), (_, _, own_s, _, callers) in found.items():
        if file != "~":
            rooms[package_of(file)] += own_s
            functions[f"{'/'.join(Path(file).parts[-2:])}:{name}"] += own_s
        elif any(part in name for part in SYSTEM_CALLS):
            rooms["operating system"] += own_s
            functions[name] += own_s
        else:
            for (caller, _, _), (*_, by_it_s, _) in callers.items():
                rooms[package_of(caller)] += by_it_s
    return _percent(rooms, len(rooms)), _percent(functions, SHOWN, sum(rooms.values()))


def package_of(file: str) -> str:
    """``drivebus.bus`` and so on; everything else is asyncio or "other"."""
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
    print_figures(figures, "profile.json", chosen.write)


if __name__ == "__main__":
    main()
