"""Misbehaving drive with Mitsubishi's computer link."""

from __future__ import annotations

from typing import Any

from drivebus.families.mitsubishi import codec as f
from verification.statements.drive_physics import DrivePhysics
from verification.statements.reaction import Reaction, Report

FORWARD_BIT, REVERSE_BIT, FAULT_BIT, RUNNING_BIT = 0x02, 0x04, 0x80, 0x01
MODE_ERROR = 0xA


class MitsubishiStation:
    """FR drive: 7AH is the status, 6FH the output frequency; parameters can't be read."""

    preset: dict[int, int] = {}

    def react(self, physics: DrivePhysics, message: Any, refuses: frozenset[str]) -> Reaction:
        """Execute a request and return the reply."""
        address, code, data = message.address, message.code, message.data
        if code in f.READ_DIGITS:
            return self._read(physics, address, code, refused="read" in refuses)
        effect = "set" if code == f.SET_FREQUENCY else "start" if data & (FORWARD_BIT | REVERSE_BIT) else "stop"
        if effect in refuses:
            return Reaction(effect=effect, reply=f.MitsubishiReply(address, error=MODE_ERROR), rejected=True)
        match effect:
            case "set":
                physics.set_frequency(data / 100)
            case "start":
                physics.start(reverse=bool(data & REVERSE_BIT))
            case _:
                physics.stop()
        return Reaction(effect=effect, reply=f.MitsubishiReply(address))

    @staticmethod
    def _read(physics: DrivePhysics, address: int, code: int, *, refused: bool) -> Reaction:
        if refused:
            return Reaction(effect="read", reply=f.MitsubishiReply(address, error=MODE_ERROR), rejected=True)
        hz = round(physics.hz * 100)
        if code != f.STATUS:
            state = "fault" if physics.fault else "running" if hz else "stopped"
            reports = Report(hz=hz / 100, state=state) if code == f.OUTPUT_FREQUENCY else Report()
            word = hz if code == f.OUTPUT_FREQUENCY else 12
            return Reaction(effect="read", reply=f.MitsubishiReply(address, word, 4), reports=reports)
        turning = REVERSE_BIT if physics.shows_reverse else FORWARD_BIT
        status = (RUNNING_BIT | turning if physics.is_on else 0) | (FAULT_BIT if physics.fault else 0)
        direction = ("reverse" if physics.shows_reverse else "forward") if physics.is_on else None
        state = "fault" if physics.fault else "running" if physics.is_on else "stopped"
        return Reaction(
            effect="read",
            reply=f.MitsubishiReply(address, status, 2),
            reports=Report(state=state, direction=direction, fault=physics.fault),
        )
