"""Misbehaving C320."""

from __future__ import annotations

from typing import Any

from drivebus.protocols import sunfar
from drivebus.protocols.sunfar import SunfarOperation, SunfarResponse, SunfarState
from verification.statements.drive_physics import DrivePhysics
from verification.statements.reaction import Reaction, Report


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
            physics.start(reverse=operation in (SunfarOperation.RUN_REVERSE, SunfarOperation.RUN_REVERSE_AT))
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
