"""Arguments of a gateway's process: one line of JSON on its standard input, so that no list of processes shows them.

Each further line is the notice of a reload that left the settings of this gateway as they are.
The service keeps the standard input open as long as it runs: its end is the end of the service, however that came.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar

from pydantic import TypeAdapter

from drivebus.service.auth.sessions import SessionStore
from drivebus.service.config.model import GatewayConfig, PlantConfig
from drivebus.service.ipc.protocol import SERVICE_SOCKET, socket_path
from drivebus.service.process.logging_setup import LogFormat

ADDRESS_USED_EXIT_CODE = 98
"""Exit code of a gateway at whose address another program listens: the number of EADDRINUSE on Linux."""
AddressOutput = Literal["plain", "json", "none"]
"""Output of the address that a gateway listens at: as text, as a line of JSON, or not at all."""

T = TypeVar("T")


@dataclass(frozen=True, slots=True, kw_only=True)
class GatewayArguments(Generic[T]):
    """Arguments of a gateway's process; ``T`` is the dataclass of its settings."""

    socket: Path
    """Socket of the service."""
    directory: Path
    """State directory."""
    user_file: Path
    settings: T
    had_users: bool = False
    """Whether the plant had users when the service started: their file may be gone when the process starts again."""
    address_output: AddressOutput = "plain"
    log_format: LogFormat = "text"
    address_use_reported: bool = False
    """The process before it ended because another program uses the address, and reported that."""


def has_users(plant: PlantConfig) -> bool:
    """Return whether a plant has users or had some when its sessions were saved."""
    return os.path.lexists(plant.user_file) or SessionStore(plant.directory).exists


def gateway_arguments(
    plant: PlantConfig,
    gateway: GatewayConfig,
    address_output: AddressOutput = "plain",
    log_format: LogFormat = "text",
    *,
    had_users: bool = False,
) -> GatewayArguments[Any]:
    """Return the arguments of one gateway of a plant."""
    return GatewayArguments(
        socket=socket_path(plant.directory, SERVICE_SOCKET),
        directory=plant.directory,
        user_file=plant.user_file,
        settings=gateway.settings,
        had_users=had_users,
        address_output=address_output,
        log_format=log_format,
    )


def encode_arguments(arguments: GatewayArguments[Any]) -> bytes:
    """Return the line that the process reads."""
    return TypeAdapter(GatewayArguments[Any]).dump_json(arguments) + b"\n"


def decode_arguments(line: bytes, settings: type[T]) -> GatewayArguments[T]:
    """Return the arguments of a line. Raises ValueError for any other line."""
    return TypeAdapter(GatewayArguments[settings]).validate_json(line)  # type: ignore[valid-type]
