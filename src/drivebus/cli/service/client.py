"""One service, asked operation by operation: over HTTP with a token, or over the plant's own socket."""

from __future__ import annotations

import asyncio
import getpass
import os
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Protocol

from drivebus.errors import ConfigurationError

Json = dict[str, Any]

TOKEN = "DRIVEBUS_TOKEN"


class Client(Protocol):
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
async def opened(service: str) -> AsyncIterator[Client]:
    """The service at an address or socket, asked first for nothing. Raises ConfigurationError."""
    client = _made(service)
    try:
        yield client
    finally:
        await client.close()


def _made(service: str) -> Client:
    if "://" in service:
        from drivebus.cli.service.http import HttpClient

        return HttpClient(service, os.environ.get(TOKEN))
    if not service:
        raise ConfigurationError("service.address", found=service)
    return LocalClient(Path(service))


class LocalClient:
    """Over ``plant.sock``, or the state directory that it lies in."""

    is_local = True

    def __init__(self, path: Path) -> None:
        from drivebus.plant.actor import local
        from drivebus.plant.socket_client import SocketClient
        from drivebus.plant.socket_paths import PLANT

        self._client = SocketClient(path / PLANT if path.is_dir() else path)
        self._actor = local(getpass.getuser(), f"cli-{os.getpid()}-{os.urandom(4).hex()}")

    async def call(self, operation: str, params: Json) -> Json:
        from drivebus.cli.service.doubt import doubtful

        with doubtful(operation, "plant.gone"):
            return await self._client.call(operation, params, self._actor)

    async def close(self) -> None:
        await self._client.close()


def ask(service: str, operation: str, params: Json) -> Json:
    """One question, for a verb that has no loop yet."""

    async def asked() -> Json:
        async with opened(service) as client:
            return await client.call(operation, params)

    return asyncio.run(asked())
