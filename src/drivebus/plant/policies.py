"""What the plant does by itself: nothing but stop (6.6, ruling 7), where a drive's policy or an interlock says so."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from drivebus.drives.state import DriveState, DriveStatus
from drivebus.errors import DrivebusError
from drivebus.plant.actor import Actor
from drivebus.plant.alarms import Own
from drivebus.plant.leases import Lease
from drivebus.plant.model import OnClientLost, OnRestart
from drivebus.plant.state import Plant
from drivebus.plant.units import Unit
from drivebus.plant.view import DriveView

SEEN_S = 3.0
"""A drive that reports standstill so long after our start stands: it would have begun by then."""
Call = Callable[[str, dict[str, Any], Actor], Awaitable[dict[str, Any]]]


class Policies:
    """Leases that ran out, interlocks, drives found running."""

    def __init__(self, plant: Plant, call: Call, service: Actor) -> None:
        self.plant, self._call, self.service = plant, call, service
        self._stopping: dict[str, asyncio.Task[None]] = {}

    def leases(self, now: float) -> None:
        """Whoever does not renew is gone: hold or stop, as the drive's policy says."""
        for lease in self.plant.leases.expired(now):
            unit = self.plant.units.get(lease.drive)
            if unit is not None:
                self._lost(unit, lease)

    def _lost(self, unit: Unit, lease: Lease) -> None:
        owner = lease.actor.name
        self.plant.tell("lease", unit.id, "plant.lease_lost", actor=owner, owner=owner)
        if not may_turn(unit) and not _lost_from_sight(unit):
            return
        if unit.setting.on_client_lost is OnClientLost.STOP:
            self.stop(unit, "plant.stopped_client_lost", owner=owner)
        else:
            self.plant.alarm(Own.LEASE_LOST, unit.id)

    def found(self, unit: Unit, status: DriveStatus) -> None:
        """The first time that a state is known: a drive that runs was started by somebody else, or in a former life."""
        state = status.state
        if state is DriveState.UNKNOWN:
            return
        if not unit.judged and state.turning and not unit.started:
            if unit.setting.on_restart is OnRestart.STOP:
                self.stop(unit, "plant.stopped_on_restart")
            else:
                self.plant.alarm(Own.NO_OWNER, unit.id)
        unit.judged = True
        if state.output_off and status.at is not None and status.at > unit.moved_at + SEEN_S:
            if not unit.drive.stop_pending:
                self.plant.calm(Own.STOP_UNCONFIRMED, unit.id)
            unit.started = False  # stopped at its keypad, or tripped: whoever starts it again is not us
        if not state.turning or self.plant.leases.get(unit.id, self.plant.now()) is not None:
            for kind in (Own.NO_OWNER, Own.LEASE_LOST):
                self.plant.calm(kind, unit.id)

    def interlocks(self, views: Mapping[str, DriveView], now: float) -> None:
        """A drive may run only while its interlocks hold; while one that stops does not, it is stopped whenever it
        turns. Only that is an alarm: one that does not hold over drives that stand is how a plant looks at rest."""
        engine = self.plant.parts.interlocks
        settings = {one.id: one for one in self.plant.setting.interlocks}
        for id, holds in engine.evaluate(views, now):
            for drive in settings[id].drives if holds else ():
                self.plant.calm(Own.INTERLOCK, drive, about=id)
        for unit in self.plant.units.values():
            stopping = engine.stopping(unit.id)
            if stopping and may_turn(unit) and not unit.drive.stop_pending and unit.id not in self._stopping:
                for one in stopping:
                    self.plant.alarm(Own.INTERLOCK, unit.id, about=one.id)
                self.stop(unit, "plant.stopped_interlock", interlock=stopping[0].id)

    def stop(self, unit: Unit, key: str, **params: str) -> None:
        """Stop it now; told as the service's own act."""
        self.plant.tell("stop", unit.id, key, actor=self.service.name, **params)
        task = asyncio.create_task(self._stop(unit), name=f"policy stop {unit.id}")
        self._stopping[unit.id] = task
        task.add_done_callback(lambda _: self._stopping.pop(unit.id, None))

    async def _stop(self, unit: Unit) -> None:
        try:
            await self._call("drive.stop", {"drive": unit.id}, self.service)
        except DrivebusError:
            return  # an unconfirmed stop has raised its alarm and is being repeated

    async def close(self) -> None:
        """The stops that are on their way have been sent; nobody waits for their confirmation any more."""
        tasks = tuple(self._stopping.values())
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


def _lost_from_sight(unit: Unit) -> bool:
    """It could tell its state and does not now: it may be running, whoever started it."""
    return unit.drive.dialect.can_tell and unit.status().state is DriveState.UNKNOWN


def may_turn(unit: Unit) -> bool:
    """It turns, or we started it and have not seen it stand since."""
    return unit.started or unit.status().state.turning
