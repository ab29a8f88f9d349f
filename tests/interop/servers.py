"""Modbus servers that nobody here wrote, each a process at the far end of a socat pair, and our link to them."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from drivebus.bus import Bus
from drivebus.drives import gate
from drivebus.drives.state import UNKNOWN
from drivebus.drives.talk import Surroundings
from drivebus.line import LineSettings
from drivebus.message import Ask, Effect, Lane, StationLink, StationTiming, WriteClass
from drivebus.ports import open_port
from drivebus.protocols import modbus

STATION = 5
TIMING = StationTiming(gap_floor_s=0.00175, reply_delay_s=0.5, lateness_s=0.2)
"""Patient: this machine may be busy."""
HASTY = replace(TIMING, reply_delay_s=0.1)
"""For servers that are killed on purpose."""
LINE = LineSettings(115200)
LOOPS = {"pymodbus": True, "libmodbus": False}
"""Who knows function 08, so that a fence can carry a nonce."""


@dataclass
class Server:
    """One peer on one wire."""

    name: str
    encoding: str
    ours: str
    launch: Callable[[], subprocess.Popen[str]]
    process: subprocess.Popen[str] | None = None

    def start(self) -> None:
        self.process = self.launch()
        assert self.process.stdout is not None
        said = self.process.stdout.readline()
        assert said == "ready\n", said + self.process.stdout.read()

    def kill(self) -> None:
        assert self.process is not None
        self.process.kill()
        self.process.wait()

    def bus(self, timing: StationTiming = TIMING) -> Bus:
        """Our master on our end, with this server as its only station."""
        bus = Bus(open_port(f"serial://{self.ours}?baud={LINE.baud}&format={LINE.format}"))
        bus.add(link(STATION, self.encoding, loops=LOOPS[self.name], timing=timing))
        return bus


def link(address: int, encoding: str = "rtu", *, loops: bool = True, timing: StationTiming = TIMING) -> StationLink:
    """A plain Modbus station: writes are settings. The fence is a loop-back, else a read of its own count."""
    codec = modbus.AsciiCodec() if encoding == "ascii" else modbus.RtuCodec()

    def effect(frame: bytes) -> Effect:
        return Effect.SETTING if modbus.written(frame, encoding) else Effect.NONE

    def fence(n: int) -> Any:
        return modbus.Loopback(address, n & 0xFFFF) if loops else modbus.ReadRegisters(address, 0, 100 + n % 20)

    return StationLink(address, codec, timing, effect, fence)


def writing(bus: Bus, request: Any) -> Ask:
    """A write with the gate's own permit, as a drive would be given it."""
    now, generation = bus.now(), bus.generation(STATION)
    command = gate.Command("test", gate.Kind.WRITE, now, generation)
    evidence = gate.Evidence(UNKNOWN, None, can_tell=False, preflight_done=True, within_limits=True)
    around = Surroundings(now, generation=generation)
    permit = gate.grant(command, STATION, Effect.SETTING, WriteClass.ABSOLUTE, around, evidence, "modbus")
    return Ask(STATION, request, Lane.COMMAND, WriteClass.ABSOLUTE, permit)


def pymodbus(started: Callable[..., subprocess.Popen[str]], theirs: str, encoding: str) -> subprocess.Popen[str]:
    script = Path(__file__).with_name("pymodbus_server.py")
    return started(sys.executable, script, theirs, STATION, encoding)
