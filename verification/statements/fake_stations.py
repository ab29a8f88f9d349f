"""Misbehaving stations of each family: which reply a request gets, and what it reports.

They share the codecs with the product and nothing else; the simulated drives of the product are not used.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from drivebus.protocols import dzb100, modbus, sunfar
from drivebus.protocols.sunfar import SunfarOperation, SunfarResponse, SunfarState
from verification.statements.drive_physics import DrivePhysics


@dataclass(frozen=True, slots=True)
class Report:
    """Content of one reply about the drive; None: it does not show it."""

    state: str | None = None
    hz: float | None = None
    setpoint_hz: float | None = None
    direction: str | None = None
    fault: int | None = None


@dataclass(slots=True, kw_only=True)
class Reaction:
    """Reaction of a station to a request."""

    effect: str
    """read, set, start, stop or reset."""
    reply: Any = None
    rejected: bool = False
    reports: Report = field(default_factory=Report)


class SunfarStation:
    """C320: every full reply carries the state."""

    preset = {0x0_01: 2, 0x0_03: 2, 0x0_02: 5000}

    def react(self, physics: DrivePhysics, message: Any, refuses: frozenset[str]) -> Reaction:
        """Execute a request and return the reply."""
        request, address = message.request, message.request.address
        before = self._report(physics)
        if isinstance(request, sunfar.SunfarControl):
            effect = self._control(physics, message.operation, request.data, refuses)
            response = SunfarResponse.RUNNING if effect in refuses else SunfarResponse.OK
            shown = before if effect == "start" else self._report(physics)
            return self._reply(physics, effect, address, 0, 0, round(physics.hz * 100), response, shown)
        if isinstance(request, sunfar.ReadMonitor):
            if "read" in refuses:
                short = sunfar.SunfarReply(address=address, response=SunfarResponse.BAD_CODE)
                return Reaction(effect="read", reply=short, rejected=True)
            hz = round(physics.hz * 100)
            return self._reply(
                physics, "read", address, 0, request.item, hz if request.item == 0 else 7, SunfarResponse.OK, before
            )
        if isinstance(request, sunfar.ReadIdentity):
            reply = sunfar.SunfarReply(
                address=address,
                response=SunfarResponse.OK,
                state=_SUNFAR_STATES[physics.state, physics.shows_reverse],
                group=request.group,
                info="000000",
                fault_code=physics.fault or None,
            )
            return Reaction(effect="read", reply=reply, reports=before)
        key = request.group << 8 | request.item
        if isinstance(request, sunfar.SunfarReadParameter):
            value = physics.memory.get(key, 0)
            return self._reply(physics, "read", address, request.group, request.item, value, SunfarResponse.OK, before)
        refused = "set" in refuses
        if not refused:
            physics.write(key, request.data)
        response = SunfarResponse.OUT_OF_RANGE if refused else SunfarResponse.OK
        data = 0 if refused else request.data
        return self._reply(physics, "set", address, request.group, request.item, data, response, before)

    def _control(self, physics: DrivePhysics, operation: Any, data: int, refuses: frozenset[str]) -> str:
        effect = _SUNFAR_EFFECTS.get(operation, "set")
        if effect in refuses:
            return effect
        if operation.sets_frequency:
            physics.set_frequency(data / 100)
        if effect == "start":
            physics.start(operation in (SunfarOperation.RUN_REVERSE, SunfarOperation.RUN_REVERSE_AT))
        elif effect == "stop":
            physics.stop()
        elif effect == "reset":
            physics.reset()
        return effect

    @staticmethod
    def _report(physics: DrivePhysics) -> Report:
        direction = ("reverse" if physics.shows_reverse else "forward") if physics.is_on and not physics.fault else None
        return Report(state=physics.state, direction=direction, fault=physics.fault)

    @staticmethod
    def _reply(
        physics: DrivePhysics,
        effect: str,
        address: int,
        group: int,
        item: int,
        data: int,
        response: SunfarResponse,
        shown: Report,
    ) -> Reaction:
        assert shown.state is not None
        code = _SUNFAR_STATES[shown.state, shown.direction == "reverse"]
        reply = sunfar.SunfarReply(
            address=address,
            response=response,
            state=code,
            group=group,
            item=None if shown.fault else item,
            data=data,
            fault_code=shown.fault or None,
        )
        monitor = effect == "read" and group == 0 and item == 0
        reports = Report(
            state=shown.state, hz=data / 100 if monitor else None, direction=shown.direction, fault=shown.fault
        )
        return Reaction(effect=effect, reply=reply, rejected=response is not SunfarResponse.OK, reports=reports)


_SUNFAR_STATES = {
    ("fault", False): SunfarState.FAULT,
    ("fault", True): SunfarState.FAULT,
    ("stopped", False): SunfarState.STOPPED,
    ("stopped", True): SunfarState.STOPPED,
    ("running", False): SunfarState.RUNNING_FORWARD,
    ("running", True): SunfarState.RUNNING_REVERSE,
    ("decelerating", False): SunfarState.DECELERATING_FORWARD,
    ("decelerating", True): SunfarState.DECELERATING_REVERSE,
}
_SUNFAR_EFFECTS = {
    SunfarOperation.RUN_FORWARD: "start",
    SunfarOperation.RUN_REVERSE: "start",
    SunfarOperation.RUN_FORWARD_AT: "start",
    SunfarOperation.RUN_REVERSE_AT: "start",
    SunfarOperation.STOP: "stop",
    SunfarOperation.STOP_AT: "stop",
    SunfarOperation.RESET_FAULT: "reset",
}


class Dzb100Station:
    """DZB100: Q01 is the output frequency, Q03 the last command and the fault."""

    preset = {0: 2, 1: 3, 10: 10, 11: 10}

    def react(self, physics: DrivePhysics, message: Any, refuses: frozenset[str]) -> Reaction:
        """Execute a request and return the reply."""
        address = message.address
        match message:
            case dzb100.Dzb100Control():
                return self._control(physics, message, refuses)
            case dzb100.Dzb100Query():
                return self._query(physics, message, refused="read" in refuses)
            case dzb100.Dzb100ReadParameter():
                data = physics.memory.get(message.parameter, 0)
                reply = dzb100.Dzb100Reply(head="R", address=address, index=message.parameter, data=data, accepted=True)
                return Reaction(effect="read", reply=reply)
        refused = "set" in refuses
        if not refused:
            physics.write(message.parameter, message.data)
        reply = dzb100.Dzb100Reply(
            head="P", address=address, index=message.parameter, data=message.data, accepted=not refused
        )
        return Reaction(effect="set", reply=reply, rejected=refused)

    def _control(self, physics: DrivePhysics, message: Any, refuses: frozenset[str]) -> Reaction:
        command = int(message.command)
        effect = {0: "stop", 1: "start", 2: "stop", 3: "start", 8: "reset"}.get(command, "set")
        refused = effect in refuses
        if not refused:
            physics.memory[-1] = command
            if effect != "stop":
                physics.set_frequency(message.data / 10)
            if effect == "start":
                physics.start(command == 3)
            elif effect == "stop":
                physics.stop()
            elif effect == "reset":
                physics.reset()
        reply = dzb100.Dzb100Reply(
            head="C", address=message.address, index=command, data=message.data, accepted=not refused
        )
        return Reaction(effect=effect, reply=reply, rejected=refused)

    def _query(self, physics: DrivePhysics, message: Any, *, refused: bool) -> Reaction:
        tenths = round(physics.hz * 10)
        shown = "running" if tenths else "fault" if physics.fault else "stopped"
        item = message.item % 10
        reserved = 0x900 if "reserved_state" in physics.misbehaviours else 0
        words = {
            0: round(physics.setpoint_hz * 10),
            1: tenths,
            2: 12,
            3: physics.memory.get(-1, 0) << 12 | reserved | physics.fault,
        }
        reports = Report(
            state=shown if item in (1, 3) else None,
            hz=tenths / 10 if item == 1 else None,
            setpoint_hz=words[0] / 10 if item == 0 else None,
            fault=physics.fault if item == 3 else None,
        )
        reply = dzb100.Dzb100Reply(
            head="Q", address=message.address, index=message.item, data=words.get(item, 0), accepted=not refused
        )
        return Reaction(effect="read", reply=reply, rejected=refused, reports=Report() if refused else reports)


class ModbusStation:
    """VC660 with a status word, DF800 (``short_errors``) without one."""

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
                physics.start(bool(value & 4))
            case "stop":
                physics.stop()
            case "reset":
                physics.reset()
            case "set" if register == 0x2001:
                physics.set_frequency(value / 100)
            case "set":
                physics.write(register & 0x7FFF, value)


def create_station(model: str) -> SunfarStation | Dzb100Station | ModbusStation:
    """Return the station of a model."""
    if model == "c320":
        return SunfarStation()
    return Dzb100Station() if model == "dzb100" else ModbusStation(has_status=model == "vc660")
