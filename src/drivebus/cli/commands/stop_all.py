"""``stop-all``: stop everything that a running plant owns, through a socket that takes nothing else."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

from drivebus.cli import output
from drivebus.cli.click_ext import Argument, CliCommand, Option
from drivebus.cli.errors import ExitCode
from drivebus.errors import ConfigurationError, ServiceUnavailable, StopUnconfirmed

ACCEPT_TIMEOUT_S = 3.0
"""A plant says at once that it has heard; only what comes of the stop takes as long as a motor takes to stand."""


def _stop_all(plant: str | None, directory: str | None) -> ExitCode:
    folder = _folder(plant, directory)
    return _print_result(asyncio.run(_request_stop(folder)))


def _folder(plant: str | None, directory: str | None) -> Path:
    """The state directory of the plant's file, mistakes or not, or as given. Raises ConfigurationError."""
    if directory is not None:
        return Path(directory)
    if plant is None:
        raise ConfigurationError("stop_all.which")
    from drivebus.service.config.load import state_directory_of

    return state_directory_of(plant)


async def _request_stop(folder: Path) -> dict[str, Any]:
    """Raises ServiceUnavailable: nobody is there; StopUnconfirmed: the plant hangs, or ended before it had told."""
    from drivebus.service.ipc.protocol import MAX_MESSAGE_BYTES, STOP_REQUEST, STOP_SOCKET, short_socket_path

    where = str(folder / STOP_SOCKET)
    try:
        with short_socket_path(folder / STOP_SOCKET) as path:
            reader, writer = await asyncio.open_unix_connection(path, limit=MAX_MESSAGE_BYTES)
        writer.write(STOP_REQUEST)
    except OSError as error:
        raise ServiceUnavailable("stop_all.nobody", socket=where) from error
    try:
        heard = await asyncio.wait_for(reader.readline(), ACCEPT_TIMEOUT_S)
        line = await reader.readline() if heard else b""
        writer.close()
    except TimeoutError:
        raise StopUnconfirmed("stop_all.hangs", socket=where, seconds=ACCEPT_TIMEOUT_S) from None
    except OSError:
        line = b""
    if not line:
        raise StopUnconfirmed("stop_all.gone", socket=where)
    found: dict[str, Any] = json.loads(line)
    return found


def _print_result(found: dict[str, Any]) -> ExitCode:
    left = [drive for bus in found["buses"].values() for drive in bus["unconfirmed"]]
    output.print_json(found)
    if left:
        output.print_message("stop_all.unconfirmed", drives=", ".join(left))
        return ExitCode.UNKNOWN
    output.print_message("stop_all.confirmed", count=len(found["outcomes"]))
    return ExitCode.DONE


command = CliCommand(
    "stop-all",
    callback=_stop_all,
    params=[
        Argument(["plant"], metavar="[PLANT.toml]", required=False, key="help.argument.plant"),
        Option(["--directory"], metavar="DIR", example="--directory /var/lib/drivebus/plants/hall"),
    ],
    examples=("drivebus stop-all plant.toml", "drivebus stop-all --directory /var/lib/drivebus/plants/hall --json"),
)
