"""One service, asked operation by operation: over HTTP with a token, or over the plant's own socket."""

from __future__ import annotations

import asyncio
import getpass
import os
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Protocol

from drivebus.errors import ConfigurationError
from drivebus.types import Json

TOKEN_VARIABLE = "DRIVEBUS_TOKEN"


class RemoteClient(Protocol):
    """How the verbs ask."""

    is_local: bool
    """By the plant's own socket: whoever may open it is trusted, and a start takes one step."""

    async def call(self, operation: str, params: Json) -> Json:
        """One of ``plant.operations``. Raises the plant's errors; ServiceUnavailable where nothing was asked,
        OutcomeUnknown where the answer to something that acts did not come.
        """
        ...

    async def close(self) -> None: ...


@asynccontextmanager
async def open_client(service: str) -> AsyncIterator[RemoteClient]:
    """The service at an address or socket, asked first for nothing. Raises ConfigurationError."""
    client = _create_client(service)
    try:
        yield client
    finally:
        await client.close()


def _create_client(service: str) -> RemoteClient:
    if "://" in service:
        from drivebus.cli.remote.http_client import HttpClient

        return HttpClient(service, os.environ.get(TOKEN_VARIABLE))
    if not service:
        raise ConfigurationError("service.address", found=service)
    return LocalClient(Path(service))


class LocalClient:
    """Over ``plant.sock``, or the state directory that it lies in."""

    is_local = True

    def __init__(self, path: Path) -> None:
        from drivebus.service.auth.actor import local_actor
        from drivebus.service.ipc.client import SocketClient
        from drivebus.service.ipc.protocol import SERVICE_SOCKET

        self._client = SocketClient(path / SERVICE_SOCKET if path.is_dir() else path)
        self._actor = local_actor(getpass.getuser(), f"cli-{os.getpid()}-{os.urandom(4).hex()}")

    async def call(self, operation: str, params: Json) -> Json:
        from drivebus.cli.remote.unknown_outcome import outcome_unknown_on_loss

        with outcome_unknown_on_loss(operation, "plant.gone"):
            return await self._client.call(operation, params, self._actor)

    async def close(self) -> None:
        await self._client.close()


def call_once(service: str, operation: str, params: Json) -> Json:
    """One question, for a verb that has no loop yet."""

    async def asked() -> Json:
        async with open_client(service) as client:
            return await client.call(operation, params)

    return asyncio.run(asked())
