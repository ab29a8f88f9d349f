"""Modbus servers that nobody here wrote, each a process at the far end of a socat pair, and our link to them."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from drivebus.bus import Bus
from drivebus.bus.messages import BusRequest, RequestPriority, RetryPolicy, StationConfig
from drivebus.drives import permissives
from drivebus.drives.operations.steps import BusConditions
from drivebus.drives.state import STATE_NOT_READ
from drivebus.ports import open_port
from drivebus.protocols import modbus
from drivebus.protocols.codec import Effect
from drivebus.serial_settings import SerialSettings, StationTiming

STATION = 5
PEER_TIMING = StationTiming(gap_floor_s=0.00175, reply_delay_s=0.5, max_reply_lateness_s=0.2)
"""Patient: this machine may be busy."""
SHORT_TIMING = replace(PEER_TIMING, reply_delay_s=0.1)
"""For servers that are killed on purpose."""
PEER_SERIAL_SETTINGS = SerialSettings(115200)
LOOPBACK_SUPPORT = {"pymodbus": True, "libmodbus": False}
"""Who knows function 08, so that a fence can carry a nonce."""


@dataclass
class PeerServer:
    """One peer on one wire."""

    name: str
    encoding: str
    ours: str
    launch: Callable[[], subprocess.Popen[str]]
    process: subprocess.Popen[str] | None = None

    def start(self) -> None:
        self.process = self.launch()
        assert self.process.stdout is not None
        text = self.process.stdout.readline()
        assert text == "ready\n", text + self.process.stdout.read()

    def kill(self) -> None:
        assert self.process is not None
        self.process.kill()
        self.process.wait()

    def bus(self, timing: StationTiming = PEER_TIMING) -> Bus:
        """Our master on our end, with this server as its only station."""
        bus = Bus(
            open_port(f"serial://{self.ours}?baud={PEER_SERIAL_SETTINGS.baud}&format={PEER_SERIAL_SETTINGS.format}")
        )
        bus.add_station(peer_station(STATION, self.encoding, loops=LOOPBACK_SUPPORT[self.name], timing=timing))
        return bus


def peer_station(
    address: int, encoding: str = "rtu", *, loops: bool = True, timing: StationTiming = PEER_TIMING
) -> StationConfig:
    """A plain Modbus station: writes are settings. The fence is a loop-back, else a read of its own count."""
    codec = modbus.ModbusAsciiCodec() if encoding == "ascii" else modbus.ModbusRtuCodec()

    def effect(frame: bytes) -> Effect:
        return Effect.SETTING if modbus.registers_written(frame, encoding) else Effect.NONE

    def fence(n: int) -> Any:
        return modbus.Diagnostics(address, n & 0xFFFF) if loops else modbus.ReadRegisters(address, 0, 100 + n % 20)

    return StationConfig(address=address, codec=codec, timing=timing, effect_of=effect, sync_request=fence)


def permitted_write(bus: Bus, request: Any) -> BusRequest:
    """A write with the gate's own permit, as a drive would be given it."""
    now, generation = bus.now(), bus.stop_epoch(STATION)
    command = permissives.DriveCommand("test", permissives.CommandKind.WRITE, now, generation)
    evidence = permissives.DriveEvidence(
        derived=STATE_NOT_READ, state_at=None, reports_run_state=False, preflight_passed=True, limits_checked=True
    )
    around = BusConditions(now=now, stop_epoch=generation)
    permit = permissives.grant_permit(
        permissives.PermitInputs(
            command=command,
            station=STATION,
            effect=Effect.SETTING,
            retry_policy=RetryPolicy.IDEMPOTENT,
            conditions=around,
            evidence=evidence,
            family="modbus",
        )
    )
    return BusRequest(STATION, request, RequestPriority.COMMAND, RetryPolicy.IDEMPOTENT, permit)


def pymodbus(started: Callable[..., subprocess.Popen[str]], theirs: str, encoding: str) -> subprocess.Popen[str]:
    script = Path(__file__).with_name("pymodbus_server.py")
    return started(sys.executable, script, theirs, STATION, encoding)
