"""Misbehaving VC660 and DF800."""

from __future__ import annotations

from typing import Any

from drivebus.protocols import modbus
from verification.statements.drive_physics import DrivePhysics
from verification.statements.reaction import Reaction, Report


class ModbusStation:
    """VC660, or without ``has_status`` the DF800: it has no status word, and its exceptions have no code."""

    def __init__(self, *, has_status: bool) -> None:
        self.has_status = has_status
        self.preset = {1: 4, 2: 5000} if has_status else {100: 5000, 101: 5, 102: 2, 107: 10, 108: 10}

    def react(self, physics: DrivePhysics, message: Any, refuses: frozenset[str]) -> Reaction:
        """Execute a request and return the reply."""
        match message:
            case modbus.Diagnostics():
                return Reaction(effect="read", reply=modbus.DiagnosticsReply(message.address, message.data))
            case modbus.ReadRegisters():
                return self._read(physics, message, refuses)
        effect = self._write_effect(message.register, message.value)
        if effect in refuses:
            return Reaction(effect=effect, reply=self._exception(message), rejected=True)
        self._execute(physics, effect, message.register, message.value)
        reply = modbus.WriteAck(message.address, 6, message.register, message.value)
        return Reaction(effect=effect, reply=reply)

    def _exception(self, message: Any) -> Any:
        return modbus.ExceptionReply(message.address, message.function, 4 if self.has_status else None)

    def _read(self, physics: DrivePhysics, message: Any, refuses: frozenset[str]) -> Reaction:
        registers = range(message.register, message.register + message.count)
        probe = not self.has_status and message.count == 2
        if "read" in refuses and not probe:
            return Reaction(effect="read", reply=self._exception(message), rejected=True)
        values = tuple(self._register(physics, register) for register in registers)
        reports = Report()
        if self.has_status:
            turning = physics.is_on
            reports = Report(
                state=("running" if turning else physics.state) if 0x3000 in registers else None,
                direction=("reverse" if physics.shows_reverse else "forward")
                if turning and 0x3000 in registers
                else None,
                fault=physics.fault if 0x3000 in registers else None,
                setpoint_hz=round(physics.setpoint_hz * 100) / 100 if 0x3001 in registers else None,
                hz=round(physics.hz * 100) / 100 if 0x3002 in registers else None,
            )
        reply = modbus.RegisterValues(message.address, message.function, values)
        return Reaction(effect="read", reply=reply, reports=reports)

    def _register(self, physics: DrivePhysics, register: int) -> int:
        if not self.has_status:
            return {3: 12, 5: round(physics.hz * 30)}.get(register, physics.memory.get(register, 0))
        match register:
            case 0x3000:
                bits = int(not physics.fault) | (physics.fault and 2) | physics.is_on << 3
                bits |= 0x0200 if "reserved_state" in physics.misbehaviours else 0
                return bits | physics.reverse << 14 | physics.shows_reverse << 15
            case 0x3001:
                return round(physics.setpoint_hz * 100)
            case 0x3002:
                return round(physics.hz * 100)
            case 0x3016:
                return 1 << physics.fault if physics.fault else 0
        return physics.memory.get(register, 0)

    def _write_effect(self, register: int, value: int) -> str:
        if register != 0x2000:
            return "set"
        if not self.has_status:
            return {1: "stop", 2: "start", 3: "start"}.get(value & 3, "reset" if value & 0x10 else "set")
        return "start" if value & 1 else "stop" if value & 0x62 else "reset" if value & 0x200 else "level"

    def _execute(self, physics: DrivePhysics, effect: str, register: int, value: int) -> None:
        match effect:
            case "start":
                physics.start(reverse=bool(value & 4))
            case "stop":
                physics.stop()
            case "reset":
                physics.reset()
            case "set" if register == 0x2001:
                physics.set_frequency(value / 100)
            case "set":
                physics.write(register & 0x7FFF, value)
