"""Commands to several drives at once that send nothing: release after a bus stop, waivers."""

from __future__ import annotations

from drivebus.errors import DrivebusError
from drivebus.service.api.errors import error_to_json
from drivebus.service.api.handlers import handles
from drivebus.service.api.operations.selections import (
    START_INHIBITS_RELEASE,
    WAIVERS_GRANT,
    SelectionParams,
    WaiversParams,
)
from drivebus.service.auth.actor import Actor
from drivebus.service.control.drive_commands import DriveCommands
from drivebus.service.runtime.drive import DriveRuntime
from drivebus.service.runtime.plant import Plant
from drivebus.types import Json

DONE = {"status": "done"}
UNCHANGED = {"status": "unchanged"}


class SelectionCommands:
    """Release and waivers of a selection of drives."""

    def __init__(self, plant: Plant, commands: DriveCommands) -> None:
        self.plant, self.commands = plant, commands

    @handles(START_INHIBITS_RELEASE)
    async def release_start_inhibits(self, params: SelectionParams, actor: Actor) -> Json:
        """Permit starts of each drive again that this actor controls or no session does."""
        selected = self.plant.selected(params.drives, params.group, everything=params.all)
        return {"outcomes": {runtime.id: self._release(runtime, actor) for runtime in selected}}

    def _release(self, runtime: DriveRuntime, actor: Actor) -> Json:
        if not runtime.bus.start_inhibited(runtime.config.address):
            return UNCHANGED
        leases, now = self.plant.leases, self.plant.now()
        is_free = leases.get(runtime.id, now) is None
        try:
            if is_free:
                leases.take(runtime.id, actor, now)
            self.commands.release_start(runtime, actor)
            if is_free:
                leases.release(runtime.id, actor, now)
        except DrivebusError as error:
            return error_to_json(error)
        return DONE

    @handles(WAIVERS_GRANT)
    async def grant_waivers(self, params: WaiversParams, actor: Actor) -> Json:
        """Record a waiver for each drive that needs one and has none."""
        outcomes: Json = {}
        for runtime in self.plant.selected(params.drives, params.group, everything=params.all):
            outcomes[runtime.id] = await self._grant(runtime, params.reason, actor)
        return {"outcomes": outcomes}

    async def _grant(self, runtime: DriveRuntime, reason: str, actor: Actor) -> Json:
        if runtime.comm_loss.view.kind == "trips" or runtime.comm_loss.waiver is not None:
            return UNCHANGED
        try:
            await self.commands.record_waiver(runtime, reason, actor)
        except DrivebusError as error:
            return error_to_json(error)
        return DONE
