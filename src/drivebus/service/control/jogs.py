"""Remote jogs: each ends when its client ends it, or half a second after the last renewal."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass

from drivebus.drives.jog_session import JogSession
from drivebus.drives.state import Direction
from drivebus.errors import ControlNotHeld, DrivebusError, NotFound, Superseded
from drivebus.service.api.errors import localized
from drivebus.service.api.handlers import handles
from drivebus.service.api.operations.drives import DRIVE_JOG, DRIVE_JOG_END, DRIVE_JOG_RENEW, ActiveJogParams, JogParams
from drivebus.service.auth.actor import Actor
from drivebus.service.control.drive_commands import DriveCommands
from drivebus.service.control.start_blockers import check_start
from drivebus.service.control.tickets import CommandTicket, check_not_stopped
from drivebus.service.runtime.drive import DriveRuntime
from drivebus.service.runtime.plant import Plant, PlantListener
from drivebus.types import Json


@dataclass(frozen=True, slots=True)
class ActiveJog:
    """A jog with its owner, ticket and commanded direction."""

    drive: DriveRuntime
    actor: Actor
    ticket: CommandTicket
    session: JogSession
    direction: Direction

    @property
    def remark(self) -> Json | None:
        """Sentence about a drive that turns and reports the other direction."""
        status = self.drive.status()
        if not status.state.turning or status.direction in (None, self.direction):
            return None
        return localized("drives.wrong_direction", {"expected": self.direction, "found": status.direction})


class RemoteJogs(PlantListener):
    """Jogs that are under way."""

    def __init__(self, plant: Plant, commands: DriveCommands) -> None:
        self.plant, self.commands = plant, commands
        plant.subscribe(self)
        self._active: dict[str, ActiveJog] = {}
        self._stop_tasks: set[asyncio.Task[None]] = set()

    @handles(DRIVE_JOG)
    async def start(self, params: JogParams, actor: Actor, ticket: CommandTicket) -> Json:
        """Start a jog, which needs everything that a start needs."""
        runtime = self.commands.require_control(params.drive, actor)
        check_start(self.plant, runtime)
        session = runtime.drive.jog(params.frequency_hz, params.direction, requested_at=ticket.issued_at)
        self.plant.arm_tokens.consume(params.arm_token, runtime.id, actor, self.plant.now())
        try:
            await self.commands.run_motion(runtime, session.start())
        except DrivebusError as error:
            self.commands.publish_failed_start(runtime, "jog", error, actor)
            raise
        id = secrets.token_urlsafe(12)
        self._active[id] = ActiveJog(runtime, actor, ticket, session, Direction(params.direction))
        if self.plant.leases.has_ended(actor.session, self.plant.now()):
            self.end_control(actor.session)
        self.on_control_end(runtime.id)
        assert session.start_outcome is not None
        answer = self.commands.publish_outcome(runtime, "jog", session.start_outcome, actor)
        return {"jog": id, "lease_s": session.lease_s, **answer}

    @handles(DRIVE_JOG_RENEW)
    async def renew(self, params: ActiveJogParams, actor: Actor) -> Json:
        """Extend a jog, with a remark on a wrong direction.

        Raises StartInhibited where it had ended: the motor was stopped; Superseded where a stop of the drive has ended
        it; ControlNotHeld where it is another session's, or another session has taken control since: then it ends.
        """
        jog = self._find(params)
        if not jog.actor.is_same_session(actor):
            raise ControlNotHeld("plant.not_owner", drive=jog.drive.id, owner=jog.actor.name)
        self._remove_stopped(params.jog)
        now = self.plant.now()
        if self.plant.leases.get(jog.drive.id, now) is not None:
            self.plant.leases.require_own(jog.drive.id, actor, now)
        jog.session.renew()
        return {"lease_s": jog.session.lease_s, "remark": jog.remark}

    @handles(DRIVE_JOG_END)
    async def stop(self, params: ActiveJogParams, actor: Actor) -> Json:
        """End a jog, also one of another session: only the right to stop is needed."""
        jog = self._find(params)
        self._active.pop(params.jog, None)
        self.plant.record_stop_request(jog.drive, by=actor.name, kind="jog")
        outcome = await self.commands.finish_stop(jog.drive, jog.session.stop())
        return self.commands.publish_outcome(jog.drive, "stop", outcome, actor)

    def _find(self, params: ActiveJogParams) -> ActiveJog:
        jog = self._active.get(params.jog)
        if jog is None or jog.drive.id != params.drive:
            raise NotFound("plant.no_jog", id=params.drive)
        return jog

    def end_control(self, session: str) -> list[str]:
        """End the jogs of a session that has ended; return their drives."""
        jogs = {id: jog for id, jog in self._active.items() if jog.actor.session == session}
        self._end(jogs, "plant.jog_ended_with_session")
        return [jog.drive.id for jog in jogs.values()]

    def on_control_end(self, drive: str) -> None:
        """End the jog of a drive that another session controls now: its stop precedes the commands of that session.

        Where no session does, it goes on.
        """
        lease = self.plant.leases.get(drive, self.plant.now())
        if lease is not None:
            jogs = {
                id: jog
                for id, jog in self._active.items()
                if jog.drive.id == drive and not jog.actor.is_same_session(lease.actor)
            }
            self._end(jogs, "plant.jog_taken_over")

    def _end(self, jogs: Mapping[str, ActiveJog], key: str) -> None:
        for id, jog in jogs.items():
            jog.session.expire()
            self._remove_expired(id, key)

    def _remove_stopped(self, id: str) -> None:
        """Remove a jog that a later stop of its drive has ended. Raises Superseded then."""
        try:
            check_not_stopped(self.plant, self._active[id].ticket)
        except Superseded:
            del self._active[id]
            raise

    def expire(self) -> None:
        """Remove jogs that were not renewed in time; one that a stop has ended without an event of its own."""
        for id in [id for id, jog in self._active.items() if jog.session.expired]:
            with suppress(Superseded):
                self._remove_stopped(id)
                self._remove_expired(id, "plant.jog_lost")

    def _remove_expired(self, id: str, key: str) -> None:
        """Remove a jog whose stop is on its way, with an event of this key; the outcome becomes another one."""
        jog = self._active.pop(id)
        self.plant.record_stop_request(jog.drive, by=jog.actor.name, kind="jog")
        self.plant.publish_event("lease", jog.drive.id, key, actor=jog.actor.name)
        stop = self.commands.report_stop(jog.drive, jog.session.stop(), jog.actor)
        task = asyncio.create_task(stop, name=f"lost jog of {jog.drive.id}")
        self._stop_tasks.add(task)
        task.add_done_callback(self._stop_tasks.discard)

    async def close(self) -> None:
        """End all jogs."""
        jogs, self._active = tuple(self._active.values()), {}
        await asyncio.gather(*(jog.session.stop() for jog in jogs), *self._stop_tasks, return_exceptions=True)
