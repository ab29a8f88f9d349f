"""Simulated drives in a process of their own, which writes down what was on their wire and what their motors did.

    bench_process.py SPECIFICATION

The record is the witness of every story here: the hosts are in other processes, may be killed, and are never asked.
Times are CLOCK_MONOTONIC, the same in every process. A motor is looked at in steps of 10 ms of its own time, so that
a busy machine does not blur when it changed. The process ends with its standard input.
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
    """One JSON document a line, whole lines only."""

    def __init__(self, path: str) -> None:
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)

    def write(self, **what: Any) -> None:
        os.write(self._fd, (json.dumps(what) + "\n").encode())


class MarkedPort:
    """What a kernel with INPCK | PARMRK hands over: FF doubled, a byte with bad parity as FF 00 byte (termios(3))."""

    def __init__(self, server: PtyServer, record: JsonLineRecord) -> None:
        self.places: list[int] = []
        """Which byte of each of the next replies came with bad parity."""
        self._record = record
        server.receive, self._plain = self._on_bytes, server.receive  # type: ignore[method-assign]

    def _on_bytes(self, data: bytes, marks: int) -> None:
        place = self.places.pop(0) if self.places else None
        place = None if place is None or place < 0 else place % len(data)
        out = bytearray()
        for index, byte in enumerate(data):
            out += bytes((0xFF, 0, byte)) if index == place else b"\xff\xff" if byte == 0xFF else bytes((byte,))
        self._record.write(what="handed", data=out.hex(), place=place)
        self._plain(bytes(out), marks)


class RecordedBus:
    """One wire with its drives, behind as many ptys as the specification asks for."""

    def __init__(self, number: int, given: dict[str, Any], record: JsonLineRecord) -> None:
        self.number, self.specification, self.record = number, given, record
        stations = [make_station(given["model"], each, given.get("settings")) for each in given["addresses"]]
        for station in stations:
            station.set_ramps(given.get("ramp_s", 0.5), given.get("ramp_s", 0.5))
            for key, value in given.get("keypad", {}).items():
                station.keypad_set(int(key), value)
            self._watch(station)
        line = SerialSettings.parse(given["baud"], given.get("format", "8N1"))
        self.bench = SimulatedBus(stations, line, line_quality=given.get("line_quality", "clean"))
        self.servers: list[PtyServer] = []
        self.marked: MarkedPort | None = None

    async def open(self) -> None:
        self.bench.now()
        self._tap()
        self.servers = [await serve_pty(self.bench, link) for link in self.specification["links"]]
        for link in self.specification["links"]:
            os.chmod(link, 0o666)  # noqa: PTH101  # other users may try
        if self.specification.get("marks"):
            self.marked = MarkedPort(self.servers[0], self.record)

    def _tap(self) -> None:
        wire: Any = self.bench.wire
        say = wire.transmit

        def received(talker: Any, data: bytes, *more: Any, **named: Any) -> Any:
            text = say(talker, data, *more, **named)
            what = "asked" if talker in self.servers else "answered"
            host = self.servers.index(talker) if talker in self.servers else None
            self._write(what=what, t=text.start, end=text.end, data=bytes(data).hex(), host=host)
            return text

        wire.transmit = received

    def _watch(self, station: Any) -> None:
        advance, last = station.advance, [(False, None)]

        def stepped(now: float) -> None:
            at = now if station.now is None else station.now
            while at < now:
                at = min(now, at + STEP_S)
                advance(at)
                look(at)
            advance(now)

        def look(at: float) -> None:
            trip = station.motor.trip.name if station.motor.trip else None
            if last[0] != (station.motor.energised, trip):
                last[0] = (station.motor.energised, trip)
                self._write(what="motor", t=at, address=station.address, on=station.motor.energised, trip=trip)

        def received(message: Any, codec: Any, line: Any, now: float, **named: Any) -> Any:
            self._write(what="heard", t=now, address=station.address)
            return obey(message, codec, line, now, **named)

        obey = station.handle_frame
        station.advance, station.handle_frame = stepped, received

    def _write(self, **what: Any) -> None:
        self.record.write(line=self.number, **what)

    def execute(self, order: dict[str, Any]) -> None:
        station = self.bench.stations[0]
        if "faults" in order:
            for name, value in order["faults"].items():
                setattr(station.faults, name, value)
        if "mark" in order:
            assert self.marked is not None
            self.marked.places += order["mark"]


async def main() -> None:
    given = json.loads(sys.argv[1])
    record = JsonLineRecord(given["record"])
    lines = [RecordedBus(number, each, record) for number, each in enumerate(given["lines"])]
    for line in lines:
        await line.open()
    ended = asyncio.Event()

    def ordered() -> None:
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

    asyncio.get_running_loop().add_reader(0, ordered)
    print("ready", flush=True)
    while not ended.is_set():
        for line in lines:
            line.bench.advance()
        await asyncio.sleep(MOTOR_SAMPLE_S)


asyncio.run(main())
