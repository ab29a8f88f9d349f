"""Modbus servers of other projects, each a process at the far end of a socat pair, and our station of them."""

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
"""Long reply delay, because this machine may be busy."""
SHORT_TIMING = replace(PEER_TIMING, reply_delay_s=0.1)
"""Short reply delay for servers that a test kills."""
PEER_SERIAL_SETTINGS = SerialSettings(115200)
LOOPBACK_SUPPORT = {"pymodbus": True, "libmodbus": False}
"""Whether a server implements function 08, so that a sync probe can carry a nonce."""


@dataclass
class PeerServer:
    """Server process on a wire."""

    name: str
    encoding: str
    our_end: str
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
        """Return our master on our end, with this server as its only station."""
        bus = Bus(
            open_port(f"serial://{self.our_end}?baud={PEER_SERIAL_SETTINGS.baud}&format={PEER_SERIAL_SETTINGS.format}")
        )
        bus.add_station(peer_station(STATION, self.encoding, loops=LOOPBACK_SUPPORT[self.name], timing=timing))
        return bus


def peer_station(
    address: int, encoding: str = "rtu", *, loops: bool = True, timing: StationTiming = PEER_TIMING
) -> StationConfig:
    """Return a plain Modbus station: writes are settings, sync probes are loop-backs or reads of varying length."""
    codec = modbus.ModbusAsciiCodec() if encoding == "ascii" else modbus.ModbusRtuCodec()

    def effect(frame: bytes) -> Effect:
        return Effect.SETTING if modbus.registers_written(frame, encoding) else Effect.NONE

    def sync_probe(n: int) -> Any:
        return modbus.Diagnostics(address, n & 0xFFFF) if loops else modbus.ReadRegisters(address, 0, 100 + n % 20)

    return StationConfig(address=address, codec=codec, timing=timing, effect_of=effect, sync_request=sync_probe)


def permitted_write(bus: Bus, request: Any) -> BusRequest:
    """Return a write request with a permit of the start permissives, as a drive's."""
    now, stop_epoch = bus.now(), bus.stop_epoch(STATION)
    command = permissives.DriveCommand("test", permissives.CommandKind.WRITE, now, stop_epoch)
    evidence = permissives.DriveEvidence(
        derived=STATE_NOT_READ,
        state_at=None,
        reports_run_state=False,
        preflight_passed=True,
        limits_checked=True,
        is_prepared=True,
        motion_seen=False,
        run_seen=False,
    )
    conditions = BusConditions(now=now, stop_epoch=stop_epoch)
    permit = permissives.grant_permit(
        permissives.PermitInputs(
            command=command,
            station=STATION,
            effect=Effect.SETTING,
            retry_policy=RetryPolicy.IDEMPOTENT,
            conditions=conditions,
            evidence=evidence,
            family="modbus",
        )
    )
    return BusRequest(
        station=STATION,
        request=request,
        priority=RequestPriority.COMMAND,
        permit=permit,
    )


def pymodbus(started: Callable[..., subprocess.Popen[str]], peer_end: str, encoding: str) -> subprocess.Popen[str]:
    script = Path(__file__).with_name("pymodbus_server.py")
    return started(sys.executable, script, peer_end, STATION, encoding)
