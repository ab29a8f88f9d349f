"""Changing the register from the command line, with a record: by the running plant, else into its trail directly."""

from __future__ import annotations

import getpass
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager

from drivebus.errors import ConfigurationError, DrivebusError
from drivebus.service.audit import AuditTrail
from drivebus.service.auth.actor import local_actor
from drivebus.service.auth.users import UserDatabase, UserFile
from drivebus.service.config.model import PlantConfig
from drivebus.service.ipc.client import SocketClient
from drivebus.service.ipc.protocol import SERVICE_SOCKET
from drivebus.service.live.views import Json
from drivebus.service.process.lock import single_instance

WriteAuditRecord = Callable[[Json], Awaitable[object]]


def user_file_of(setting: PlantConfig) -> UserFile:
    """Where the plant's users are kept."""
    return UserFile(setting.users or setting.directory / "access.json")


async def change_users(
    setting: PlantConfig, what: str, target: str, params: Json, change: Callable[[UserDatabase], UserDatabase]
) -> UserDatabase:
    """The register after ``change``, recorded before and after. Raises what ``change`` does; AuditUnavailable and
    ServiceUnavailable, and nothing is changed, where it can't be recorded."""
    async with _audit_writer(setting) as write:
        entry: Json = {"what": what, "target": target, "params": params}
        await write(entry | {"outcome": "asked"})
        try:
            after = user_file_of(setting).change(change)
        except DrivebusError as error:
            await write(entry | {"outcome": error.key})
            raise
        await write(entry | {"outcome": "done"})
    return after


@asynccontextmanager
async def _audit_writer(setting: PlantConfig) -> AsyncIterator[WriteAuditRecord]:
    """The trail of a plant that does not run, else the plant itself."""
    actor = local_actor(getpass.getuser(), "command-line")
    try:
        lock = single_instance(setting.directory)
        lock.__enter__()
    except ConfigurationError as error:
        if error.key != "plant.runs_already":
            raise
        client = SocketClient(setting.directory / SERVICE_SOCKET)
        try:
            yield lambda entry: client.record(entry, actor)
        finally:
            await client.close()
        return
    trail = AuditTrail(setting.directory)
    try:
        await trail.open()
        yield lambda entry: trail.record_json(
            entry | {"who": actor.name, "session": actor.session, "address": actor.address}
        )
    finally:
        await trail.close()
        lock.__exit__(None, None, None)
