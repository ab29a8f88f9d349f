"""What is done to one drive. Every handler takes its checked parameters and the actor; rights were looked at before."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable
from dataclasses import asdict
from math import inf
from typing import Any

from drivebus.drives.memory import DriveLimits
from drivebus.drives.state import Outcome
from drivebus.errors import DrivebusError, LimitError, NotOwner, StopUnconfirmed
from drivebus.plant import operations as ask
from drivebus.plant.actor import Actor
from drivebus.plant.alarms import Own
from drivebus.plant.failure import outcome_json
from drivebus.plant.leases import ARM_S, TTL_S
from drivebus.plant.parts import Handler
from drivebus.plant.starting import check
from drivebus.plant.state import Plant, narrower
from drivebus.plant.units import Unit
from drivebus.plant.waivers import Waiver
from drivebus.plant.wishes import Motion, Wish

Json = dict[str, Any]
Follow = Callable[[Unit, float, Actor], Awaitable[Json]]


async def _nobody(leader: Unit, frequency_hz: float, actor: Actor) -> Json:
    return {}


class Commands:
    """Leases, arms, motion, parameters, waivers and limits of single drives."""

    def __init__(self, plant: Plant) -> None:
        self.plant = plant
        self.follow: Follow = _nobody
        """Called with a drive whose frequency has changed: its followers' part of the answer."""

    def handlers(self) -> dict[str, Handler]:
        return {
            "lease.take": self.take, "lease.renew": self.renew, "lease.release": self.give_up, "drive.arm": self.arm,
            "drive.stop": self.stop, "drive.reset": self.reset, "drive.release": self.release,
            "drive.waiver": self.waive, "drive.unwaive": self.unwaive, "drive.limits": self.limit,
            "parameters.write": self.write,
        }  # fmt: skip

    def motions(self) -> dict[str, Motion]:
        return {"drive.run": self.run, "drive.set_frequency": self.set_frequency}

    def own(self, drive: str, actor: Actor) -> Unit:
        """The drive, which the actor may command now. Raises NotFound, NotOwner."""
        unit = self.plant.unit(drive)
        self.plant.leases.need(drive, actor, self.plant.now())
        return unit

    def own_with_followers(self, drive: str, actor: Actor) -> Unit:
        """``own`` for who changes a frequency that others follow. Raises NotOwner, before anything is sent, unless the
        actor may command each of them too."""
        unit = self.own(drive, actor)
        for _, follower in self.plant.followers(drive):
            try:
                self.own(follower.id, actor)
            except NotOwner as error:
                raise NotOwner("plant.follower_not_owned", drive=follower.id, leader=drive, why=error) from error
        return unit

    # --- who may --------------------------------------------------------------------------------------------------

    async def take(self, params: ask.OfDrive, actor: Actor) -> Json:
        unit, now = self.plant.unit(params.drive), self.plant.now()
        taken = self.plant.leases.take(unit.id, actor, now)
        if taken is not None:
            self.plant.tell("lease", unit.id, "plant.lease_taken", actor=actor.name, owner=taken.actor.name)
        return self._lease(unit)

    async def renew(self, params: ask.OfDrive, actor: Actor) -> Json:
        unit = self.plant.unit(params.drive)
        self.plant.leases.renew(unit.id, actor, self.plant.now())
        return self._lease(unit)

    async def give_up(self, params: ask.OfDrive, actor: Actor) -> Json:
        unit = self.plant.unit(params.drive)
        self.plant.leases.release(unit.id, actor, self.plant.now())
        return {}

    def _lease(self, unit: Unit) -> Json:
        now = self.plant.now()
        lease = self.plant.leases.get(unit.id, now)
        return {"lease": None if lease is None else lease.view(now).as_json(), "ttl_s": TTL_S}

    async def arm(self, params: ask.OfDrive, actor: Actor) -> Json:
        """The first step; refused for whatever the second would be refused for."""
        unit = self.own(params.drive, actor)
        check(self.plant, unit)
        return {"arm": self.plant.arms.arm(unit.id, actor, self.plant.now()), "expires_s": ARM_S}

    # --- motion ---------------------------------------------------------------------------------------------------

    async def run(self, params: ask.Run, actor: Actor, wish: Wish) -> Json:
        unit = self.own_with_followers(params.drive, actor)
        check(self.plant, unit)
        unit.drive.check_frequency(params.frequency_hz)
        self.plant.arms.use(params.arm, unit.id, actor, self.plant.now())
        told = await self.start(unit, params.frequency_hz, params.direction, actor, wish.at)
        return told | {"followers": await self.follow(unit, params.frequency_hz, actor)}

    async def start(
        self, unit: Unit, frequency_hz: float, direction: str | None, actor: Actor, wished_at: float
    ) -> Json:
        """Everything is allowed; from the moment its frame may have left the drive is one that we started."""
        outcome = await self.moved(unit, unit.drive.run(frequency_hz, direction, wished_at=wished_at))
        unit.commanded_hz = frequency_hz
        return self.told(unit, "run", outcome, actor, frequency_hz=frequency_hz)

    async def moved(self, unit: Unit, motion: Awaitable[Outcome]) -> Outcome:
        """Do it; where nothing can have left, the drive is as much ours as it was."""
        before, unit.started, unit.moved_at = unit.started, True, inf
        try:
            return await motion
        except DrivebusError as error:
            if error.outcome is None:
                unit.started = before
            raise
        finally:
            unit.moved_at = self.plant.now()

    async def set_frequency(self, params: ask.SetFrequency, actor: Actor, wish: Wish) -> Json:
        unit = self.own_with_followers(params.drive, actor)
        outcome = await unit.drive.set_frequency(params.frequency_hz, wish.at)
        unit.commanded_hz = params.frequency_hz
        told = self.told(unit, "set_frequency", outcome, actor, frequency_hz=params.frequency_hz)
        return told | {"followers": await self.follow(unit, params.frequency_hz, actor)}

    async def stop(self, params: ask.StopDrive, actor: Actor) -> Json:
        """Nothing is asked first: no lease, no arm, no record (6.5). The frame is queued before anything is awaited."""
        unit = self.plant.unit(params.drive)
        self.plant.stopped(unit)
        ways = {"stop": unit.drive.stop, "coast": unit.drive.coast, "quick_stop": unit.drive.quick_stop}
        return self.told(unit, "stop", await self.ended(unit, ways[params.how]()), actor)

    async def ended(self, unit: Unit, stop: Awaitable[Outcome]) -> Outcome:
        """A stop's outcome; one that is not confirmed raises an alarm, and is repeated by the drive itself."""
        try:
            outcome = await stop
        except StopUnconfirmed:
            self.plant.alarm(Own.STOP_UNCONFIRMED, unit.id)
            raise
        unit.started, unit.commanded_hz = False, None
        self.plant.tally.ended(outcome)
        self.plant.calm(Own.STOP_UNCONFIRMED, unit.id)
        return outcome

    async def reset(self, params: ask.OfDrive, actor: Actor) -> Json:
        unit = self.own(params.drive, actor)
        return self.told(unit, "reset", await unit.drive.reset_fault(), actor)

    async def release(self, params: ask.OfDrive, actor: Actor) -> Json:
        """Starts may be asked for again after a bus stop; nothing is sent."""
        unit = self.own(params.drive, actor)
        unit.bus.release([unit.setting.address])
        self.plant.tell("command", unit.id, "plant.released", actor=actor.name)
        return {}

    def told(self, unit: Unit, word: str, outcome: Outcome, actor: Actor, **params: Any) -> Json:
        """The outcome as JSON; everybody who listens hears of it too."""
        said = outcome_json(outcome, self.plant.command_id(word))
        self.plant.tell(
            "stop" if word == "stop" else "command", unit.id, f"plant.did_{word}", actor=actor.name,
            outcome=str(outcome.word), **params, how=outcome,
        )  # fmt: skip
        return {"outcome": said}

    async def write(self, params: ask.WriteParameters, actor: Actor) -> Json:
        """To RAM, or with ``save`` to EEPROM, each read back. Needs the lease: a parameter may move a motor."""
        unit = self.own(params.drive, actor)
        unit.doubt_badge()
        try:
            outcome = await unit.drive.write(params.values, params.save)
        finally:
            unit.doubt_badge()  # what was read meanwhile may have been the old value
        self.plant.tell("configuration", unit.id, "plant.did_write", actor=actor.name, outcome=str(outcome.word))
        return {"outcome": outcome_json(outcome, self.plant.command_id("write"))}

    # --- what an engineer allows ------------------------------------------------------------------------------------

    async def waive(self, params: ask.Waiver, actor: Actor) -> Json:
        unit = self.plant.unit(params.drive)
        text = f"{params.reason} ({actor.name})"
        waiver = Waiver.of(text, unit.setting, self.plant.line_of(unit).setting)
        await self._keep(f"waiver/{unit.id}", waiver.to_keep())
        unit.waiver = text
        self.plant.tell("waiver", unit.id, "plant.waived", actor=actor.name, reason=params.reason)
        return {"waiver": text}

    async def _keep(self, key: str, value: str) -> None:
        """Durable on return; the bus does not wait for the disk. Raises ConfigurationError."""
        await asyncio.to_thread(self.plant.store.put, key, value)

    async def unwaive(self, params: ask.OfDrive, actor: Actor) -> Json:
        unit = self.plant.unit(params.drive)
        await self._keep(f"waiver/{unit.id}", "")
        unit.waiver, unit.waiver_of_another = None, None
        self.plant.tell("waiver", unit.id, "plant.unwaived", actor=actor.name)
        return {}

    async def limit(self, params: ask.Limits, actor: Actor) -> Json:
        """Narrower than the plant's file says, never wider. Raises LimitError."""
        unit = self.plant.unit(params.drive)
        own = DriveLimits(params.minimum_hz, params.maximum_hz, params.forward, params.reverse)
        lowest, highest = max(own.minimum_hz, unit.file_range_hz[0]), unit.file_range_hz[1]
        wanted = highest if own.maximum_hz is None else own.maximum_hz
        if wanted > highest or own.minimum_hz > wanted or lowest > wanted:
            raise LimitError("plant.limits", drive=unit.id, minimum_hz=unit.file_range_hz[0], maximum_hz=highest)
        await self._keep(f"limits/{unit.id}", json.dumps(asdict(own)))
        unit.limit(narrower(own, unit.setting.limits))
        self.plant.tell("configuration", unit.id, "plant.limited", actor=actor.name)
        low, high = unit.drive.range_hz
        return {"minimum_hz": low, "maximum_hz": high}
