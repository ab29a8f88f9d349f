"""Jogs held from afar: each ends when its holder lets go, or half a second after the last renewal (T13)."""

from __future__ import annotations

import asyncio
import secrets
from dataclasses import dataclass
from typing import Any

from drivebus.drives.lease import JogLease
from drivebus.errors import DrivebusError, NotFound, NotOwner
from drivebus.plant import operations as ask
from drivebus.plant.actor import Actor
from drivebus.plant.commands import Commands
from drivebus.plant.parts import Handler
from drivebus.plant.starting import check
from drivebus.plant.state import Plant
from drivebus.plant.units import Unit
from drivebus.plant.wishes import Motion, Wish

Json = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Held:
    """One jog and who holds it."""

    unit: Unit
    actor: Actor
    lease: JogLease


class Jogs:
    """Jogs that go on now."""

    def __init__(self, plant: Plant, commands: Commands) -> None:
        self.plant, self.commands = plant, commands
        self._held: dict[str, Held] = {}
        self._ending: set[asyncio.Task[None]] = set()

    def handlers(self) -> dict[str, Handler]:
        return {"drive.jog_renew": self.renew, "drive.jog_end": self.end}

    def motions(self) -> dict[str, Motion]:
        return {"drive.jog": self.jog}

    async def jog(self, params: ask.Jog, actor: Actor, wish: Wish) -> Json:
        """A jog is a start: it needs all that a start needs."""
        unit = self.commands.own(params.drive, actor)
        check(self.plant, unit)
        lease = unit.drive.jog(params.frequency_hz, params.direction, wished_at=wish.at)
        self.plant.arms.use(params.arm, unit.id, actor, self.plant.now())
        await self.commands.moved(unit, _begun(lease))
        word = secrets.token_urlsafe(12)
        self._held[word] = Held(unit, actor, lease)
        assert lease.begun is not None
        told = self.commands.told(unit, "jog", lease.begun, actor)
        return {"jog": word, "lease_s": lease.lease_s, **told}

    async def renew(self, params: ask.JogHeld, actor: Actor) -> Json:
        """The hand is still on the key. Raises GateError where it came too late: the motor was stopped."""
        held = self._find(params)
        if held.actor.session != actor.session:
            raise NotOwner("plant.not_owner", drive=held.unit.id, owner=held.actor.name)
        held.lease.renew()
        return {"lease_s": held.lease.lease_s}

    async def end(self, params: ask.JogHeld, actor: Actor) -> Json:
        """Whoever may stop may end it."""
        held = self._find(params)
        self._held.pop(params.jog, None)
        self.plant.stopped(held.unit)
        outcome = await self.commands.ended(held.unit, _ended(held.lease))
        return self.commands.told(held.unit, "stop", outcome, actor)

    def _find(self, params: ask.JogHeld) -> Held:
        held = self._held.get(params.jog)
        if held is None or held.unit.id != params.drive:
            raise NotFound("plant.no_jog", id=params.drive)
        return held

    def sweep(self) -> None:
        """Jogs whose lease was lost: their stop is on its way already; who hears of it is told how it ended."""
        for word, held in tuple(self._held.items()):
            if held.lease.lost:
                del self._held[word]
                self.plant.stopped(held.unit)
                self.plant.tell("lease", held.unit.id, "plant.jog_lost", actor=held.actor.name)
                task = asyncio.create_task(self._lost(held), name=f"lost jog of {held.unit.id}")
                self._ending.add(task)
                task.add_done_callback(self._ending.discard)

    async def _lost(self, held: Held) -> None:
        try:
            outcome = await self.commands.ended(held.unit, _ended(held.lease))
        except DrivebusError:
            return  # an unconfirmed stop has raised its alarm and is being repeated
        self.commands.told(held.unit, "stop", outcome, held.actor)

    async def close(self) -> None:
        """End them all."""
        held, self._held = tuple(self._held.values()), {}
        await asyncio.gather(*(_ended(one.lease) for one in held), *self._ending, return_exceptions=True)


async def _begun(lease: JogLease) -> Any:
    await lease.__aenter__()
    return lease.begun


async def _ended(lease: JogLease) -> Any:
    await lease.__aexit__(None, None, None)
    return lease.ended
