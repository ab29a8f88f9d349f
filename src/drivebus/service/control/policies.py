"""Automatic stops: lost leases, tripped interlocks, drives found running. Nothing starts a drive automatically."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any

from drivebus.drives.state import DriveStatus
from drivebus.errors import DrivebusError
from drivebus.service.alarms import SystemAlarm
from drivebus.service.api.operations.drives import DRIVE_STOP
from drivebus.service.auth.actor import Actor
from drivebus.service.config.model import OnClientLost, OnRestart, title_of
from drivebus.service.control.leases import ControlLease
from drivebus.service.live.views import DriveView
from drivebus.service.runtime.drive import DriveRuntime
from drivebus.service.runtime.failure_log import failure_logged
from drivebus.service.runtime.plant import Plant
from drivebus.values import Text, bilingual_text

OperationCall = Callable[[str, dict[str, Any], Actor], Awaitable[dict[str, Any]]]


class StopPolicies:
    """Policies of a plant; each stop goes through the dispatcher, so that it is recorded."""

    def __init__(self, plant: Plant, call: OperationCall, service: Actor) -> None:
        self.plant, self._call, self.service_actor = plant, call, service
        self._stopping: dict[str, asyncio.Task[None]] = {}
        self._announced_trips: dict[str, set[str]] = {}  # by drive, until the interlock holds or the drive stands still

    def expire_leases(self, now: float) -> None:
        """Handle leases that have ended: stop the drive or leave it running, by its ``on_client_lost``."""
        self._on_leases_ended(self.plant.leases.pop_expired(now), "plant.lease_lost")

    def end_control(self, session: str, ended_by: str) -> list[str]:
        """End the control of a session that has ended; return the drives."""
        leases = self.plant.leases.end_session(session, self.plant.now())
        reason = bilingual_text(f"plant.session_ended.{ended_by}")
        self._on_leases_ended(leases, "plant.lease_ended_with_session", reason=reason)
        return [lease.drive for lease in leases]

    def _on_leases_ended(self, leases: Sequence[ControlLease], key: str, **params: Any) -> None:
        for lease in leases:
            runtime = self.plant.drives.get(lease.drive)
            if runtime is not None:
                with failure_logged():
                    self._on_lease_ended(runtime, lease, key, params)

    def _on_lease_ended(self, runtime: DriveRuntime, lease: ControlLease, key: str, params: Mapping[str, Any]) -> None:
        owner = lease.actor.name
        if not lease.claimed:
            self._on_hand_over_unused(runtime, owner)
            return
        self.plant.publish_event("lease", runtime.id, key, actor=owner, owner=owner, **params)
        state_lost = runtime.state_is_unknown and runtime.drive.dialect.reports_run_state
        if runtime.drive.stopping or not (runtime.may_be_running or state_lost):
            return
        if runtime.config.on_client_lost is OnClientLost.STOP:
            self.stop_drive(runtime, "plant.stopped_client_lost", owner=owner)
        else:
            self._alarm_control_lost(runtime)

    def _on_hand_over_unused(self, runtime: DriveRuntime, owner: str) -> None:
        """Handle control that was handed over and never used: the drive goes on as after a release, with an alarm."""
        self.plant.publish_event("lease", runtime.id, "plant.control_not_taken", actor=owner, owner=owner)
        if runtime.may_turn:
            self._alarm_control_lost(runtime, sentence="control_not_taken", owner=owner)

    def _alarm_control_lost(self, runtime: DriveRuntime, **params: str) -> None:
        """Raise the alarm; a drive of which no read shows the motor turning only may be running."""
        key = "alarms.motion.running" if runtime.turning else "alarms.motion.possible"
        self.plant.raise_alarm(SystemAlarm.CONTROL_LOST, runtime.id, motion=bilingual_text(key), **params)

    def apply_on_restart(self, runtime: DriveRuntime, status: DriveStatus) -> None:
        """Stop a drive found running when this service started, or adopt it with an alarm, by its ``on_restart``."""
        if runtime.state_was_known or runtime.started_by_service or not status.state.turning:
            return
        if runtime.config.on_restart is OnRestart.STOP:
            self.stop_drive(runtime, "plant.stopped_on_restart")
        else:
            runtime.adopted = True
            self.plant.raise_alarm(SystemAlarm.RUNNING_AT_START, runtime.id)

    def enforce_interlocks(self, views: Mapping[str, DriveView], now: float) -> None:
        """Stop every drive that may turn and has a tripped interlock of the action ``stop``, and raise its alarm.

        A tripped interlock of drives at standstill is no alarm: at rest, a plant has many. Each trip is announced once.
        """
        engine = self.plant.interlocks
        settings = {interlock.id: interlock for interlock in self.plant.config.interlocks}
        for id, holds in engine.evaluate(views, now):
            for drive in settings[id].drives if holds else ():
                self.plant.clear_alarm(SystemAlarm.INTERLOCK_TRIP, drive, subject=id)
                self._announced_trips.get(drive, set()).discard(id)
        for runtime in self.plant.drives.values():
            with failure_logged():
                self._stop_tripped(runtime)

    def _stop_tripped(self, runtime: DriveRuntime) -> None:
        """Stop a drive that may turn, where an interlock of it is tripped."""
        tripped = self.plant.interlocks.tripped_stops(runtime.id)
        if not tripped or not runtime.may_turn:
            self._announced_trips.pop(runtime.id, None)
        elif not runtime.drive.stopping and runtime.id not in self._stopping:
            self._start_stop(runtime)
            self._announce_trips(runtime, {interlock.id: title_of(interlock) for interlock in tripped})

    def _announce_trips(self, runtime: DriveRuntime, interlocks: Mapping[str, Text]) -> None:
        """Raise the alarm of each tripped interlock, and publish the stop request, unless that is done already.

        ``interlocks``: their titles by id.
        """
        announced = self._announced_trips.setdefault(runtime.id, set())
        new = [id for id in interlocks if id not in announced]
        announced.update(new)
        for id in new:
            self.plant.raise_alarm(SystemAlarm.INTERLOCK_TRIP, runtime.id, subject=id, interlock=interlocks[id])
        if new:
            self._publish_stop(runtime, "plant.stopped_interlock", interlock=interlocks[new[0]])

    def stop_drive(self, runtime: DriveRuntime, key: str, **params: str) -> None:
        """Stop a drive in the name of the service."""
        self._publish_stop(runtime, key, **params)
        self._start_stop(runtime)

    def _publish_stop(self, runtime: DriveRuntime, key: str, **params: Any) -> None:
        self.plant.publish_event("stop", runtime.id, key, actor=self.service_actor.name, **params)

    def _start_stop(self, runtime: DriveRuntime) -> None:
        task = asyncio.create_task(self._send_stop(runtime), name=f"policy stop {runtime.id}")
        self._stopping[runtime.id] = task
        task.add_done_callback(lambda done: self._on_stop_done(runtime.id, done))

    def _on_stop_done(self, drive: str, done: asyncio.Task[None]) -> None:
        """Forget a finished stop, unless a later one of the same drive has taken its place."""
        if self._stopping.get(drive) is done:
            del self._stopping[drive]

    async def _send_stop(self, runtime: DriveRuntime) -> None:
        with suppress(DrivebusError):  # an unconfirmed stop has raised its alarm and is being repeated
            await self._call(DRIVE_STOP.name, {"drive": runtime.id}, self.service_actor)

    async def close(self) -> None:
        """Cancel waiting for confirmations; the stops themselves have been sent."""
        tasks = tuple(self._stopping.values())
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
