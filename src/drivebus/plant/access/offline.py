"""Changing the register from the command line, with a record: by the running plant, else into its trail directly."""

from __future__ import annotations

import getpass
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager

from drivebus.errors import ConfigurationError, DrivebusError
from drivebus.plant.access.register import Register
from drivebus.plant.access.store import AccessFile
from drivebus.plant.actor import local
from drivebus.plant.audit import AuditTrail
from drivebus.plant.lock import only_one
from drivebus.plant.model import PlantSetting
from drivebus.plant.socket_client import SocketClient
from drivebus.plant.socket_paths import PLANT
from drivebus.plant.view import Json

Write = Callable[[Json], Awaitable[object]]


def file_of(setting: PlantSetting) -> AccessFile:
    """Where the plant's users are kept."""
    return AccessFile(setting.users or setting.directory / "access.json")


async def changed(
    setting: PlantSetting, what: str, target: str, params: Json, change: Callable[[Register], Register]
) -> Register:
    """The register after ``change``, recorded before and after. Raises what ``change`` does; AuditUnavailable and
    ServiceUnavailable, and nothing is changed, where it can't be recorded."""
    async with _trail(setting) as write:
        entry: Json = {"what": what, "target": target, "params": params}
        await write(entry | {"outcome": "asked"})
        try:
            after = file_of(setting).change(change)
        except DrivebusError as error:
            await write(entry | {"outcome": error.key})
            raise
        await write(entry | {"outcome": "done"})
    return after


@asynccontextmanager
async def _trail(setting: PlantSetting) -> AsyncIterator[Write]:
    """The trail of a plant that does not run, else the plant itself."""
    actor = local(getpass.getuser(), "command-line")
    try:
        lock = only_one(setting.directory)
        lock.__enter__()
    except ConfigurationError as error:
        if error.key != "plant.runs_already":
            raise
        client = SocketClient(setting.directory / PLANT)
        try:
            yield lambda entry: client.record(entry, actor)
        finally:
            await client.close()
        return
    trail = AuditTrail(setting.directory)
    try:
        await trail.open()
        yield lambda entry: trail.write(entry | {"who": actor.name, "session": actor.session, "address": actor.address})
    finally:
        await trail.close()
        lock.__exit__(None, None, None)
