"""Hosts that are killed, stopped and frozen by the tests: real Bus and Drive on real ptys, in a process of their own.

    host_process.py WHAT MODEL URL...

``run``: start address 1 of every line, one after the other, and keep polling. ``start N``: tell "queued" as soon as
runs of addresses 1 to N of the first line are wished, then how each ended.
"""

from __future__ import annotations

import asyncio
import json
import sys
from dataclasses import replace
from typing import Any

from drivebus import profiles
from drivebus.bus import Bus
from drivebus.drives import Drive, MemoryStore
from drivebus.errors import DrivebusError
from drivebus.ports import open_port


def tell(**what: Any) -> None:
    print(json.dumps(what), flush=True)


def made(bus: Bus, model: str, address: int = 1) -> Drive:
    """A drive whose replies may be late by a third of a second: nobody knows how busy this machine is."""
    timing = replace(profiles.load(model).timing, adapter_s=0.3)
    return Drive(bus, model, address, store=MemoryStore(), timing=timing)


async def run(model: str, urls: list[str]) -> None:
    buses = [Bus(open_port(url)) for url in urls]
    for bus in buses:
        await bus.open()
    drives = [made(bus, model) for bus in buses]
    tell(event="open")
    for number, drive in enumerate(drives):
        outcome = await drive.run(20.0)
        drive.monitor(period_s=0.2)
        tell(event="started", line=number, word=outcome.word)
    tell(event="all")
    await asyncio.sleep(3600)


async def wish(drive: Drive) -> dict[str, Any]:
    try:
        outcome = await drive.run(20.0)
        return {"address": drive.address, "word": outcome.word}
    except DrivebusError as error:
        return {"address": drive.address, "error": type(error).__name__, "text": str(error)}


async def start(model: str, url: str, count: int) -> None:
    async with Bus(open_port(url)) as bus:
        drives = [made(bus, model, address) for address in range(1, count + 1)]
        wishes = [asyncio.create_task(wish(drive)) for drive in drives]
        await asyncio.sleep(0)
        tell(event="queued")
        for done in wishes:
            tell(event="ended", **await done)


def main() -> None:
    what, model, *rest = sys.argv[1:]
    if what == "run":
        asyncio.run(run(model, rest))
    else:
        asyncio.run(start(model, rest[0], int(rest[1])))


if __name__ == "__main__":
    main()
