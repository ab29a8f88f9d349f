"""Simulated drives in their own process, which records all frames on their wires and all changes of their motors.

    bench_process.py SPECIFICATION

The tests judge by this record only, because the hosts are in other processes and may be killed. Times are
CLOCK_MONOTONIC, the same in every process. A motor is sampled in steps of 10 ms of its own time, so that its changes
have exact times on a busy machine too. The process ends with its standard input.
"""

from __future__ import annotations

import asyncio
import json
import os
import sys
from typing import Any

from drivebus.serial_settings import SerialSettings
from drivebus.simulator.bus import SimulatedBus
from drivebus.simulator.models.catalog import make_station
from drivebus.simulator.pty_server import PtyServer, serve_pty

STEP_S = 0.01
MOTOR_SAMPLE_S = 0.05


class JsonLineRecord:
    """Record file with one JSON document a line, written in whole lines."""

    def __init__(self, path: str) -> None:
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)

    def write(self, **entry: Any) -> None:
        os.write(self._fd, (json.dumps(entry) + "\n").encode())


class MarkedPort:
    """Port with a kernel's INPCK | PARMRK marks: FF doubled, a byte with bad parity as FF 00 byte (termios(3))."""

    def __init__(self, server: PtyServer, record: JsonLineRecord) -> None:
        self.places: list[int] = []
        """Index of the byte with bad parity in each of the next replies; -1: none."""
        self._record = record
        server.receive, self._plain = self._on_bytes, server.receive  # type: ignore[method-assign]

    def _on_bytes(self, data: bytes, marks: int) -> None:
        place = self.places.pop(0) if self.places else None
        place = None if place is None or place < 0 else place % len(data)
        out = bytearray()
        for index, byte in enumerate(data):
            out += bytes((0xFF, 0, byte)) if index == place else b"\xff\xff" if byte == 0xFF else bytes((byte,))
        self._record.write(what="delivered", data=out.hex(), place=place)
        self._plain(bytes(out), marks)


class RecordedBus:
    """Wire with its drives, and a pty for each link of the specification."""

    def __init__(self, number: int, specification: dict[str, Any], record: JsonLineRecord) -> None:
        self.number, self.specification, self.record = number, specification, record
        stations = [
            make_station(specification["model"], each, specification.get("settings"))
            for each in specification["addresses"]
        ]
        for station in stations:
            station.set_ramps(specification.get("ramp_s", 0.5), specification.get("ramp_s", 0.5))
            for key, value in specification.get("keypad", {}).items():
                station.keypad_set(int(key), value)
            self._watch(station)
        line = SerialSettings.parse(specification["baud"], specification.get("format", "8N1"))
        self.bench = SimulatedBus(stations, line, line_quality=specification.get("line_quality", "clean"))
        self.servers: list[PtyServer] = []
        self.marked: MarkedPort | None = None

    async def open(self) -> None:
        self.bench.now()
        self._tap()
        self.servers = [await serve_pty(self.bench, link) for link in self.specification["links"]]
        for link in self.specification["links"]:
            os.chmod(link, 0o666)  # noqa: PTH101  # for hosts of other users
        if self.specification.get("marks"):
            self.marked = MarkedPort(self.servers[0], self.record)

    def _tap(self) -> None:
        wire: Any = self.bench.wire
        transmit = wire.transmit

        def recorded_transmit(sender: Any, data: bytes, *more: Any, **named: Any) -> Any:
            transmission = transmit(sender, data, *more, **named)
            what = "request" if sender in self.servers else "reply"
            host = self.servers.index(sender) if sender in self.servers else None
            self._write(what=what, t=transmission.start, end=transmission.end, data=bytes(data).hex(), host=host)
            return transmission

        wire.transmit = recorded_transmit

    def _watch(self, station: Any) -> None:
        advance, last = station.advance, [(False, None)]

        def advance_in_steps(now: float) -> None:
            at = now if station.now is None else station.now
            while at < now:
                at = min(now, at + STEP_S)
                advance(at)
                sample(at)
            advance(now)

        def sample(at: float) -> None:
            trip = station.motor.trip.name if station.motor.trip else None
            if last[0] != (station.motor.energised, trip):
                last[0] = (station.motor.energised, trip)
                self._write(what="motor", t=at, address=station.address, on=station.motor.energised, trip=trip)

        def received(message: Any, codec: Any, settings: Any, now: float, **named: Any) -> Any:
            self._write(what="received", t=now, address=station.address)
            return handle_frame(message, codec, settings, now, **named)

        handle_frame = station.handle_frame
        station.advance, station.handle_frame = advance_in_steps, received

    def _write(self, **entry: Any) -> None:
        self.record.write(line=self.number, **entry)

    def execute(self, order: dict[str, Any]) -> None:
        station = self.bench.stations[0]
        if "faults" in order:
            for name, value in order["faults"].items():
                setattr(station.faults, name, value)
        if "mark" in order:
            assert self.marked is not None
            self.marked.places += order["mark"]


async def main() -> None:
    specification = json.loads(sys.argv[1])
    record = JsonLineRecord(specification["record"])
    lines = [RecordedBus(number, each, record) for number, each in enumerate(specification["lines"])]
    for line in lines:
        await line.open()
    ended = asyncio.Event()

    def read_orders() -> None:
        text = os.read(0, 65536)
        if not text:
            ended.set()
            return
        for each in text.decode().splitlines():
            order = json.loads(each)
            lines[order.get("line", 0)].execute(order)
            for line in lines:
                line.bench.advance()
            record.write(what="done", number=order["number"])

    asyncio.get_running_loop().add_reader(0, read_orders)
    print("ready", flush=True)
    while not ended.is_set():
        for line in lines:
            line.bench.advance()
        await asyncio.sleep(MOTOR_SAMPLE_S)


asyncio.run(main())
