"""Misbehaving DZB100."""

from __future__ import annotations

from typing import Any

from drivebus.protocols import dzb100
from verification.statements.drive_physics import DrivePhysics
from verification.statements.reaction import Reaction, Report


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
                physics.start(reverse=command == 3)
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
