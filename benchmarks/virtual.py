"""Virtual time: how fast a day of bus traffic can be simulated."""

from __future__ import annotations

import asyncio
import time

from benchmarks.clients.links import link
from benchmarks.harness import Figures
from drivebus.bus import Bus
from drivebus.bus.core import BusCore
from drivebus.bus.effects import Done, Transmit, WakeAt
from drivebus.bus.planner import Poll
from drivebus.line import LineSettings
from drivebus.message import Answer
from drivebus.ports import open_port
from drivebus.protocols.modbus import ReadRegisters, Registers, RtuCodec
from drivebus.testing import virtual

STATIONS = 31


def bare(transactions: int) -> float:
    """Transactions a second of the pure core alone: 31 stations polled, each reply there when its last bit would be."""
    core, codec, line = BusCore(LineSettings(19_200), echo="off"), RtuCodec(), LineSettings(19_200)
    replies = {}
    for address in range(1, STATIONS + 1):
        core.add(link(address, codec, 0.002))
        replies[address] = codec.encode_reply(Registers(address, 3, (address << 8,) * 4))
    done, now, pending = 0, 0.0, core.opened(0.0)
    for address in range(1, STATIONS + 1):
        pending += core.watch(address, [Poll(ReadRegisters(address, 0, 4), 0.01)], address, now)
    began = time.perf_counter()
    wake: float | None = None
    while done < transactions:
        reply = b""
        for act in pending:
            if type(act) is Transmit:
                reply = replies[act.data[0]]
            elif type(act) is WakeAt:
                wake = act.when
            elif type(act) is Done:
                assert act.answer.error is None
                done += 1
        if reply:
            now += 0.002 + line.seconds(8 + len(reply))
            pending = core.received(reply, now)
        else:
            assert wake is not None
            now = wake
            pending = core.woke(now)
    return transactions / (time.perf_counter() - began)


async def _line(seconds: float) -> int:
    heard = 0

    def sink(answer: Answer) -> None:
        nonlocal heard
        heard += answer.error is None

    async with Bus(open_port(f"sim://vc660@1-{STATIONS}?baud=9600")) as bus:
        for address in range(1, STATIONS + 1):
            bus.add(link(address, RtuCodec(), 0.03))
            bus.watch(address, [Poll(ReadRegisters(address, 0x3000, 4), 0.05)], sink)
        await asyncio.sleep(seconds)
    return heard


def run(transactions: int = 30_000, seconds: float = 120.0) -> Figures:
    """``bare``: the pure core. ``real_time_factor``: 31 simulated VC660 with motors on one 9,600-baud line."""
    began = time.perf_counter()
    heard = virtual.run(_line(seconds))
    wall = time.perf_counter() - began
    return {
        "bare_transactions_per_s": round(bare(transactions)),
        "line_transactions_per_s": round(heard / wall),
        "real_time_factor": round(seconds / wall, 1),
        "bus_seconds": seconds,
    }
