"""Drives that start together: one after another, not too many at once, followers at their ratio to the leader.

The leader comes first, and nobody follows a leader that does not go.
"""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Any

from drivebus.drives.state import DriveState, OutcomeWord
from drivebus.errors import DrivebusError, Expired, NotOwner, PlantError, Superseded
from drivebus.plant import operations as ask
from drivebus.plant.actor import Actor
from drivebus.plant.commands import Commands
from drivebus.plant.failure import failure
from drivebus.plant.leases import ARM_S
from drivebus.plant.model import GroupSetting
from drivebus.plant.parts import Handler
from drivebus.plant.starting import check
from drivebus.plant.state import Plant
from drivebus.plant.units import Unit
from drivebus.plant.view import text_json
from drivebus.plant.wishes import Motion, Wish, still

Json = dict[str, Any]
LOOK_S = 0.1
ACCELERATING = (DriveState.ACCELERATING, DriveState.RESTARTING)
LONGEST_RAMP_S = 10.0
"""A drive that does not tell counts as accelerating for its own ramp, or for so long where that is not known."""


class Groups:
    """Starts and setpoints of groups."""

    def __init__(self, plant: Plant, commands: Commands) -> None:
        self.plant, self.commands = plant, commands
        self.progress: dict[str, int] = {}
        """Groups that are being started, and how many of their drives have been."""
        commands.follow = self.follow

    def handlers(self) -> dict[str, Handler]:
        return {"group.arm": self.arm}

    def motions(self) -> dict[str, Motion]:
        return {"group.start": self.start, "group.set_frequency": self.set_frequency}

    def _own(self, id: str, actor: Actor) -> tuple[GroupSetting, list[Unit]]:
        """Its drives, the leader first."""
        group = self.plant.group(id)
        order = sorted(group.drives, key=lambda drive: drive != group.leader)
        return group, [self.commands.own(drive, actor) for drive in order]

    async def arm(self, params: ask.OfGroup, actor: Actor) -> Json:
        """The first step; refused for whatever the second would be refused for."""
        group, units = self._own(params.group, actor)
        for unit in units:
            check(self.plant, unit)
        return {"arm": self.plant.arms.arm(f"group:{group.id}", actor, self.plant.now()), "expires_s": ARM_S}

    async def start(self, params: ask.GroupStart, actor: Actor, wish: Wish) -> Json:
        """Nothing is sent unless every drive may start at its frequency. A stop of any of them ends the rest, and so
        does a leader that has not started.

        The first drive's start is as old as the wish, each further one's as its turn: the lease shows that the wish
        lives on. Raises Expired (NotReached, where its frequency has left) for the first: then no other is tried.
        """
        group, units = self._own(params.group, actor)
        if group.id in self.progress:
            raise Superseded("plant.group_starting", group=group.id)
        for unit in units:
            check(self.plant, unit)
            unit.drive.check_frequency(share_hz(group, unit.id, params.frequency_hz))
        self.plant.arms.use(params.arm, f"group:{group.id}", actor, self.plant.now())
        self.progress[group.id] = 0
        outcomes: Json = {}
        try:
            for unit in units:
                outcomes[unit.id] = await self._turn(group, units, unit, wish, params, actor)
                if unit.id == group.leader and not _done(outcomes[unit.id]):
                    return {"outcomes": outcomes | _left(group, units[1:])}
                self.progress[group.id] += 1
                wish = replace(wish, at=self.plant.now())
        finally:
            self.progress.pop(group.id, None)
        return {"outcomes": outcomes}

    async def _turn(
        self, group: GroupSetting, units: list[Unit], unit: Unit, wish: Wish, params: ask.GroupStart, actor: Actor
    ) -> Json:
        """One drive's start, when it is its turn and nobody has stopped any of them since."""
        try:
            wished_at = await self._my_turn(group, units, unit, wish)
            still(self.plant, wish)
            self._still_owns(unit, actor)
            check(self.plant, unit)
            if any(one.id not in self.plant.units for one in units):
                raise Superseded("plant.another_meanwhile", drive=unit.id)
            frequency_hz = share_hz(group, unit.id, params.frequency_hz)
            found = await self.commands.start(unit, frequency_hz, params.direction, actor, wished_at)
        except DrivebusError as error:
            if unit is units[0] and _late(error):
                raise  # the wish itself is too old, and so it is for all of them
            return failure(error)
        unit.started_at = self.plant.now()
        said: Json = found["outcome"]
        return said

    def _still_owns(self, unit: Unit, actor: Actor) -> None:
        """Whoever has gone while the others started starts nothing more. Raises NotOwner."""
        lease = self.plant.leases.get(unit.id, self.plant.now())
        if lease is None or lease.actor.session != actor.session:
            raise NotOwner("plant.lease_gone", drive=unit.id)

    async def _my_turn(self, group: GroupSetting, units: list[Unit], unit: Unit, wish: Wish) -> float:
        """Since when its start is wished: where it has to wait, since its turn has come. Raises Superseded."""
        wished_at = wish.at
        while not self._is_free(group, units, unit):
            await asyncio.sleep(LOOK_S)
            wished_at = self.plant.now()
            still(self.plant, wish)
        return wished_at

    def _is_free(self, group: GroupSetting, units: list[Unit], unit: Unit) -> bool:
        now = self.plant.now()
        last = max((one.started_at for one in units if one.started_at is not None and one.started), default=None)
        busy = sum(1 for one in units if one is not unit and self._accelerates(one, now))
        return (last is None or now - last >= group.stagger_s) and busy < group.at_once

    def _accelerates(self, unit: Unit, now: float) -> bool:
        if unit.started_at is None or not unit.started:
            return False
        status = unit.status()
        if status.state is DriveState.UNKNOWN:
            ramp_s = unit.drive.acceleration_s
            return now - unit.started_at < (LONGEST_RAMP_S if ramp_s is None else ramp_s)
        fresh = status.at is not None and status.at >= unit.started_at
        return not fresh or status.state in ACCELERATING

    async def set_frequency(self, params: ask.GroupSetFrequency, actor: Actor, wish: Wish) -> Json:
        """The leader's frequency (everybody's where there is no leader), then the followers' at their ratio."""
        group, units = self._own(params.group, actor)
        for unit in units:
            unit.drive.check_frequency(share_hz(group, unit.id, params.frequency_hz))
        first = units[:1] if group.leader else []
        outcomes = {
            unit.id: await self._set(unit, share_hz(group, unit.id, params.frequency_hz), actor) for unit in first
        }
        rest = units[len(first) :]
        if not all(map(_done, outcomes.values())):
            return {"outcomes": outcomes | _left(group, rest)}
        found = await asyncio.gather(*(self._share(group, unit, params.frequency_hz, actor, wish) for unit in rest))
        return {"outcomes": outcomes | {unit.id: one for unit, one in zip(rest, found, strict=True)}}

    async def _share(self, group: GroupSetting, unit: Unit, frequency_hz: float, actor: Actor, wish: Wish) -> Json:
        """Unless one of them has been stopped while the leader got its frequency."""
        try:
            still(self.plant, wish)
        except Superseded as error:
            return failure(error)
        return await self._followed(group, unit, frequency_hz, actor)

    async def _set(self, unit: Unit, frequency_hz: float, actor: Actor) -> Json:
        try:
            outcome = await unit.drive.set_frequency(frequency_hz)
        except DrivebusError as error:
            return failure(error)
        unit.commanded_hz = frequency_hz
        said: Json = self.commands.told(unit, "set_frequency", outcome, actor, frequency_hz=frequency_hz)["outcome"]
        return said

    async def follow(self, leader: Unit, frequency_hz: float, actor: Actor) -> Json:
        """The leader got another frequency: whoever follows it and runs gets its share."""
        found: Json = {}
        for group, unit in self.plant.followers(leader.id):
            found[unit.id] = await self._followed(group, unit, frequency_hz, actor)
        return found

    async def _followed(self, group: GroupSetting, unit: Unit, frequency_hz: float, actor: Actor) -> Json:
        """Its lease may have ended while the leader was commanded, or it may just have been started by another."""
        try:
            self.commands.own(unit.id, actor)
        except NotOwner as error:
            self.plant.tell("command", unit.id, "plant.does_not_follow", actor=actor.name, why=error)
            return failure(error)
        return await self._set(unit, share_hz(group, unit.id, frequency_hz), actor)

    def view(self, group: GroupSetting) -> Json:
        """Topic ``groups/<id>``."""
        started = self.progress.get(group.id)
        progress = None if started is None else {"started": started, "of": len(group.drives)}
        state = "starting" if progress else self._state(group)
        return {
            "id": group.id, "title": text_json(group.title), "drives": list(group.drives), "leader": group.leader,
            "ratios": dict(group.ratios), "state": state, "progress": progress,
        }  # fmt: skip

    def _state(self, group: GroupSetting) -> str:
        states = [self.plant.units[id].status().state for id in group.drives if id in self.plant.units]
        if any(state is DriveState.UNKNOWN for state in states):
            return "unknown"
        turning = [state.turning for state in states]
        return "running" if all(turning) else "mixed" if any(turning) else "stopped"


def _late(error: DrivebusError) -> bool:
    """Was it not sent because it was too old, be it after its frequency had been?"""
    return isinstance(error, Expired) or isinstance(error.params.get("why"), Expired)


def _done(outcome: Json) -> bool:
    return outcome.get("word") in (OutcomeWord.CONFIRMED, OutcomeWord.ACKNOWLEDGED)


def _left(group: GroupSetting, units: list[Unit]) -> Json:
    """What becomes of the followers of a leader that did not do it."""
    return {unit.id: failure(PlantError("plant.leader_not_done", drive=unit.id, leader=group.leader)) for unit in units}


def share_hz(group: GroupSetting, drive: str, frequency_hz: float) -> float:
    """What the drive gets when its group (or leader) gets ``frequency_hz``."""
    return frequency_hz * group.ratios.get(drive, 1.0)
