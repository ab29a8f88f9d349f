"""Audited changes of the user database from the command line.

The running service writes the audit records; if none runs, they are appended to the trail directly.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress

from drivebus.errors import AuditUnavailable, ConfigurationError, DrivebusError, ServiceUnavailable
from drivebus.service.audit import AuditEntry, AuditTrail
from drivebus.service.auth.actor import local_actor, local_user
from drivebus.service.auth.users import UserDatabase, UserFile
from drivebus.service.config.model import PlantConfig
from drivebus.service.ipc.client import SocketClient
from drivebus.service.ipc.protocol import SERVICE_SOCKET, socket_path
from drivebus.service.process.lock import single_instance
from drivebus.types import Json

WriteAuditRecord = Callable[[Json], Awaitable[object]]


def user_file_of(config: PlantConfig) -> UserFile:
    """Return the user file of a plant."""
    return UserFile(config.user_file)


async def change_users(
    config: PlantConfig, what: str, target: str, params: Json, change: Callable[[UserDatabase], UserDatabase]
) -> UserDatabase:
    """Change the user database, with an audit record before and after it, and return it.

    Raises the errors of ``change``; AuditUnavailable and ServiceUnavailable if it cannot be recorded, and then nothing
    is changed.
    """
    async with _audit_writer(config) as write:
        entry: Json = {"what": what, "target": target, "params": params}
        await write(entry | {"outcome": "requested"})
        try:
            after = user_file_of(config).change(change)
        except DrivebusError as error:
            with suppress(AuditUnavailable, ServiceUnavailable):  # the caller needs the first error
                await write(entry | {"outcome": error.key})
            raise
        with suppress(AuditUnavailable, ServiceUnavailable):  # the change is done, and recorded as requested
            await write(entry | {"outcome": "done"})
    return after


@asynccontextmanager
async def _audit_writer(config: PlantConfig) -> AsyncIterator[WriteAuditRecord]:
    """Yield the writer of audit records: the running service, else the trail itself."""
    actor = local_actor(local_user(), "command-line")
    try:
        lock = single_instance(config.directory)
        lock.__enter__()
    except ConfigurationError as error:
        if error.key != "plant.runs_already":
            raise
        client = SocketClient(socket_path(config.directory, SERVICE_SOCKET))
        try:
            yield lambda entry: client.record(entry, actor)
        finally:
            await client.close()
        return
    trail = AuditTrail.of(config)
    try:
        await trail.open()
        yield lambda entry: trail.record(AuditEntry.from_json(entry, actor))
    finally:
        await trail.close()
        lock.__exit__(None, None, None)
