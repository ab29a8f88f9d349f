"""Misbehaving Huanyang HY."""

from __future__ import annotations

from typing import Any

from drivebus.families.huanyang import codec as h
from verification.statements.drive_physics import DrivePhysics
from verification.statements.reaction import Reaction, Report

RUN_BIT, STOP_BIT, OTHER_DIRECTION_BIT = 0x01, 0x08, 0x10
"""Bits of a control request."""
ONE_BYTE_PARAMETERS = (1, 2, 23, 143, 163, 164, 165)


class HuanyangStation:
    """HY drive: status item 0 is the set frequency, 1 the output frequency; nothing reports a fault or a direction."""

    preset = {1: 2, 2: 2, 5: 5000, 14: 100, 15: 100, 23: 1}

    def react(self, physics: DrivePhysics, message: Any, refuses: frozenset[str]) -> Reaction:
        """Execute a request and return the reply."""
        address, function, index = message.address, message.function, message.index
        match function:
            case h.READ:
                return self._value(physics, message, "read", refused=False)
            case h.WRITE:
                refused = "set" in refuses
                if not refused:
                    physics.write(index, message.value)
                return self._value(physics, message, "set", refused=refused)
            case h.STATUS:
                return self._status(physics, address, index, refused="read" in refuses)
            case h.CONTROL:
                return self._control(physics, address, message.value, refuses)
        refused = "set" in refuses
        if refused:
            return _rejected("set", address, function, 0)
        physics.set_frequency(message.value / 100)
        return Reaction(effect="set", reply=h.HuanyangReply(address, function, 0, message.value))

    @staticmethod
    def _value(physics: DrivePhysics, message: Any, effect: str, *, refused: bool) -> Reaction:
        if refused:
            return _rejected(effect, message.address, message.function, message.index)
        width = 1 if message.index in ONE_BYTE_PARAMETERS else 2
        value = physics.memory.get(message.index, 0)
        reply = h.HuanyangReply(message.address, message.function, message.index, value, width)
        return Reaction(effect=effect, reply=reply)

    @staticmethod
    def _status(physics: DrivePhysics, address: int, item: int, *, refused: bool) -> Reaction:
        if refused:
            return _rejected("read", address, h.STATUS, item)
        setpoint, output = round(physics.setpoint_hz * 100), round(physics.hz * 100)
        word = {0: setpoint, 1: output}.get(item, 12)
        shown = "running" if output else "stopped"
        reports = Report(
            state=shown if item == 1 else None,
            hz=output / 100 if item == 1 else None,
            setpoint_hz=setpoint / 100 if item == 0 else None,
        )
        return Reaction(effect="read", reply=h.HuanyangReply(address, h.STATUS, item, word), reports=reports)

    @staticmethod
    def _control(physics: DrivePhysics, address: int, bits: int, refuses: frozenset[str]) -> Reaction:
        effect = "stop" if bits & STOP_BIT else "start" if bits & RUN_BIT else "set"
        if effect in refuses:
            return _rejected(effect, address, h.CONTROL, bits)
        if effect == "stop":
            physics.stop()
        elif effect == "start":
            physics.start(reverse=bool(bits & OTHER_DIRECTION_BIT))
        state = physics.is_on | physics.is_on << 3
        return Reaction(effect=effect, reply=h.HuanyangReply(address, h.CONTROL, 0, state, 1))


def _rejected(effect: str, address: int, function: int, index: int) -> Reaction:
    return Reaction(effect=effect, reply=h.HuanyangReply(address, function, index, accepted=False), rejected=True)
