"""How the plant tells the web process what to be: ``python -m drivebus.web SOCKET SETTING``, the setting as JSON."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from pydantic import TypeAdapter

from drivebus.service.config.model import PlantConfig, WebConfig

AddressOutput = Literal["plain", "json", "not"]
"""How the page's address is told on standard output: by itself, as a line of JSON, or by somebody else."""


@dataclass(frozen=True, slots=True)
class WebArguments:
    """What the web process needs to know besides the plant's socket."""

    directory: Path
    """The state directory: where the set-up secret is put."""
    user_file: Path
    web: WebConfig
    address_output: AddressOutput = "plain"
    parent_pid: int = field(default_factory=os.getpid)
    """The plant's own number, told and not asked for: it may be gone before its child can look."""


_WEB_ARGUMENTS_ADAPTER = TypeAdapter(WebArguments)


def web_command(setting: PlantConfig, socket: Path, announce: AddressOutput = "plain") -> list[str]:
    """The command line that starts it."""
    child = WebArguments(setting.directory, setting.users or setting.directory / "users.json", setting.web, announce)
    return [sys.executable, "-m", "drivebus.web", str(socket), _WEB_ARGUMENTS_ADAPTER.dump_json(child).decode()]


def parse_web_arguments(arguments: list[str]) -> tuple[Path, WebArguments]:
    """What ``command`` said after ``drivebus.web``; defaults beside the socket where it says no setting.

    Raises ValueError where that is no such command line.
    """
    match arguments:
        case [socket]:
            directory = Path(socket).parent
            return Path(socket), WebArguments(directory, directory / "users.json", WebConfig(), parent_pid=os.getppid())
        case [socket, setting]:
            return Path(socket), _WEB_ARGUMENTS_ADAPTER.validate_json(setting)
    raise ValueError("SOCKET [SETTING]")
