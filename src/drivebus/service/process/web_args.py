"""Command line of the web process: ``python -m drivebus.web SOCKET ARGUMENTS``, the arguments as JSON."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from pydantic import TypeAdapter

from drivebus.service.config.model import PlantConfig, WebConfig

AddressOutput = Literal["plain", "json", "not"]
"""Output of the page's address: as text, as a line of JSON, or not at all."""


@dataclass(frozen=True, slots=True)
class WebArguments:
    """Arguments of the web process besides the service's socket."""

    directory: Path
    """State directory, which holds the set-up secret."""
    user_file: Path
    web: WebConfig
    address_output: AddressOutput = "plain"
    parent_pid: int = field(default_factory=os.getpid)
    """Process id of the service, passed because the service may end before its child can ask for it."""


_WEB_ARGUMENTS_ADAPTER = TypeAdapter(WebArguments)


def web_command(setting: PlantConfig, socket: Path, announce: AddressOutput = "plain") -> list[str]:
    """Return the command line of the web process."""
    child = WebArguments(setting.directory, setting.users or setting.directory / "users.json", setting.web, announce)
    return [sys.executable, "-m", "drivebus.web", str(socket), _WEB_ARGUMENTS_ADAPTER.dump_json(child).decode()]


def parse_web_arguments(arguments: list[str]) -> tuple[Path, WebArguments]:
    """Return socket and arguments of a command line of ``web_command``; without arguments, defaults beside the socket.

    Raises ValueError for any other command line.
    """
    match arguments:
        case [socket]:
            directory = Path(socket).parent
            return Path(socket), WebArguments(directory, directory / "users.json", WebConfig(), parent_pid=os.getppid())
        case [socket, setting]:
            return Path(socket), _WEB_ARGUMENTS_ADAPTER.validate_json(setting)
    raise ValueError("SOCKET [SETTING]")
