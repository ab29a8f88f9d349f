"""Client of a service: over HTTP with a token, or over the socket of the service on this machine."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Protocol

from drivebus.errors import ConfigurationError, DrivebusError
from drivebus.types import Json

TOKEN_VARIABLE = "DRIVEBUS_TOKEN"


class RemoteClient(Protocol):
    """Calls operations of one service."""

    is_local: bool
    """True on the socket of the service: its user is trusted, and a start takes one step."""

    async def call(self, operation: str, params: Json) -> Json:
        """Execute one of ``service.api.operations``.

        Raises the errors of the service; ServiceUnavailable if nothing was sent; OutcomeUnknown if the response to a
        mutating operation is missing.
        """
        ...

    async def close(self) -> None: ...


@asynccontextmanager
async def open_client(service: str) -> AsyncIterator[RemoteClient]:
    """Provide a client of the service at an address or socket; sends nothing. Raises ConfigurationError."""
    client = _create_client(service)
    try:
        yield client
    finally:
        await client.close()


def _create_client(service: str) -> RemoteClient:
    if "://" in service:
        from drivebus.cli.remote.http_client import HttpClient

        return HttpClient(service, os.environ.get(TOKEN_VARIABLE))
    path = Path(service)
    may_be_socket = len(path.parts) > 1 or path.suffix == ".sock" or path.is_dir() or path.is_socket()
    if not may_be_socket or path.suffix == ".toml":  # HOST:PORT, or a plant's file
        raise ConfigurationError("service.address", found=service)
    return LocalClient(path)


class LocalClient:
    """Client on the socket of the service, named by its path or by the state directory."""

    is_local = True

    def __init__(self, path: Path) -> None:
        """Raises ConfigurationError for the socket of ``stop --all``."""
        from drivebus.service.auth.actor import local_actor, local_user
        from drivebus.service.ipc.client import SocketClient
        from drivebus.service.ipc.protocol import SERVICE_SOCKET, STOP_SOCKET, socket_path

        if path.name == STOP_SOCKET:  # beside the socket of the service, and takes one request only
            raise ConfigurationError("service.address", found=str(path))
        self._client = SocketClient(socket_path(path, SERVICE_SOCKET) if path.is_dir() else path)
        self._actor = local_actor(local_user(), f"cli-{os.getpid()}-{os.urandom(4).hex()}")

    async def call(self, operation: str, params: Json) -> Json:
        from drivebus.cli.remote.unknown_outcome import outcome_unknown_on_loss

        with outcome_unknown_on_loss(operation):
            try:
                return await self._client.call(operation, params, self._actor)
            except DrivebusError as error:
                from drivebus.cli.remote.convert import parse_error_outcome

                raise parse_error_outcome(error) from None

    async def close(self) -> None:
        await self._client.close()


def call_once(service: str, operation: str, params: Json) -> Json:
    """Execute one operation in an event loop of its own."""

    async def call() -> Json:
        async with open_client(service) as client:
            return await client.call(operation, params)

    return asyncio.run(call())
