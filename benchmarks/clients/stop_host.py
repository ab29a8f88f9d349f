"""Process whose stops are measured: all buses full, other work on the same loop, stops at random instants.

    stop_host.py PATHS STATIONS SECONDS BAUD DEAD SEED CALLS

Writes CALLS: a line for each stop with the number of its bus, its address, the nanoseconds (CLOCK_MONOTONIC) of the
call and of the write of its first frame to the port, and the number of frames written in between. Prints the TCP port
of its other work, and at the end the figures of that work and the bounds.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import random
import sys
import time
from pathlib import Path

from benchmarks.latency import VC660_STOP_WRITE
from benchmarks.wire_analysis import LONGEST_REPLY_BYTES
from drivebus.bus import Bus, Poll
from drivebus.bus.load import estimate_bus_load
from drivebus.bus.messages import BusResult
from drivebus.drives import Drive, MemoryStore
from drivebus.errors import StopUnconfirmed
from drivebus.ports import open_port
from drivebus.protocols.modbus import ReadRegisters
from verification.drive_variants import TimingBounds
from verification.families.modbus.facts import VC660

PERIOD_S = 0.01
"""Poll period: shorter than a bus allows, so that a poll is always due."""
PAUSE_S = 0.1
"""Longest pause between a confirmed stop and the next stop on its bus."""
WARM_UP_S = 1.0
RecordedCall = tuple[int, int, int, int, int]


class SideWork:
    """Other work on the loop for each received line of JSON: 4 KiB hashed, sixty rows of JSON made and sent."""

    def __init__(self) -> None:
        self.done, self.busy_s = 0, 0.0
        self._page = bytes(4096)

    def answer(self, request: dict[str, int]) -> bytes:
        begun = time.perf_counter()
        digest = hashlib.sha256(self._page).hexdigest()
        rows = [{"row": n, "request": request["n"], "digest": digest[:8], "value": n * 0.1} for n in range(60)]
        answer = json.dumps(rows).encode() + b"\n"
        self.busy_s += time.perf_counter() - begun
        self.done += 1
        return answer


class SideWorkConnection(asyncio.Protocol):
    """Connection of a client that requests the other work, one line at a time."""

    def __init__(self, work: SideWork) -> None:
        self._work = work

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        for line in data.splitlines():
            self._transport.write(self._work.answer(json.loads(line)))


class WrittenFrames:
    """Recorder of a bus's writes to its port: the number of frames, and the time of each address's stop."""

    def __init__(self, bus: Bus) -> None:
        self.frames, self.stops = 0, dict[int, tuple[int, int]]()
        self._write = bus.port.write
        bus.port.write = self.write  # type: ignore[method-assign]

    def write(self, data: bytes, /) -> None:
        if data[1:4] == VC660_STOP_WRITE and data[5] & 2:
            self.stops.setdefault(data[0], (time.monotonic_ns(), self.frames))
        self.frames += 1
        self._write(data)


async def stops(
    number: int, written: WrittenFrames, drives: list[Drive], until: float, seed: int, calls: list[RecordedCall]
) -> int:
    """Stop one drive after the other at random instants; returns the number of unconfirmed stops."""
    chance, unconfirmed = random.Random(f"{seed}/{number}"), 0
    while time.monotonic() < until:
        await asyncio.sleep(chance.uniform(0.0, PAUSE_S))
        drive = chance.choice(drives)
        written.stops.clear()
        before, called = written.frames, time.monotonic_ns()
        try:
            await drive.stop()
        except StopUnconfirmed:
            unconfirmed += 1
        at, frames = written.stops.get(drive.address, (0, before))
        calls.append((number, drive.address, called, at, frames - before))
    return unconfirmed


def print_figures(**figures: float) -> None:
    print(json.dumps(figures), flush=True)


def write_calls(file: Path, calls: list[RecordedCall]) -> None:
    file.write_text("".join(" ".join(map(str, call)) + "\n" for call in calls))


def ignore_answer(_: BusResult) -> None:
    """Ignore the reply: the polls are only load."""


async def main() -> None:
    paths, file = sys.argv[1], sys.argv[7]
    stations, seconds, baud, dead, seed = (int(text) for text in sys.argv[2:7])
    buses = [Bus(open_port(path, baud=baud, format="8N1", echo="off")) for path in paths.split(",")]
    made = [[Drive(bus, "vc660", a, store=MemoryStore()) for a in range(1, stations + 1)] for bus in buses]
    polls = [
        (drive.dialect.station_config, [Poll(ReadRegisters(drive.address, 0x3000, 4), PERIOD_S)]) for drive in made[0]
    ]
    bound = estimate_bus_load(polls, buses[0].settings).drives[1].stop_bound_s
    written = [WrittenFrames(bus) for bus in buses]
    for bus in buses:
        await bus.open()
        for link, poll in polls:
            bus.start_polling(link.address, poll, ignore_answer)
    work = SideWork()
    server = await asyncio.get_running_loop().create_server(lambda: SideWorkConnection(work), "127.0.0.1", 0)
    print_figures(port=server.sockets[0].getsockname()[1])
    await asyncio.sleep(WARM_UP_S)
    calls: list[RecordedCall] = []
    work.done, work.busy_s, begun = 0, 0.0, time.monotonic()
    alive = [[drive for drive in drives if drive.address != dead] for drives in made]
    unconfirmed = await asyncio.gather(
        *(stops(number, written[number], drives, begun + seconds, seed, calls) for number, drives in enumerate(alive))
    )
    took = time.monotonic() - begun
    write_calls(Path(file), calls)
    print_figures(
        unconfirmed=sum(unconfirmed),
        requests_per_s=work.done / took,
        request_ms=work.busy_s / max(work.done, 1) * 1e3,
        bound_s=bound,
        own_bound_s=TimingBounds(VC660, buses[0].settings).stop_bound_s,
        timeout_s=made[0][0].dialect.station_config.timing.timeout_s(buses[0].settings, LONGEST_REPLY_BYTES),
        gap_s=made[0][0].dialect.station_config.timing.gap_s(buses[0].settings),
        occupied_percent=min(bus.statistics().occupied_percent for bus in buses),
    )
    for bus in buses:
        await bus.close()


asyncio.run(main())
