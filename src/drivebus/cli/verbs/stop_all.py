"""``stop-all``: stop everything that a running plant owns, through a socket that takes nothing else."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

from drivebus.cli import voice
from drivebus.cli.command import Argument, Option, Verb
from drivebus.cli.exits import Exit
from drivebus.errors import ConfigurationError, ServiceUnavailable, StopUnconfirmed

HEARD_S = 3.0
"""A plant says at once that it has heard; only what comes of the stop takes as long as a motor takes to stand."""


def _stop_all(plant: str | None, directory: str | None) -> Exit:
    folder = _folder(plant, directory)
    return _tell(asyncio.run(_asked(folder)))


def _folder(plant: str | None, directory: str | None) -> Path:
    """The state directory of the plant's file, mistakes or not, or as given. Raises ConfigurationError."""
    if directory is not None:
        return Path(directory)
    if plant is None:
        raise ConfigurationError("stop_all.which")
    from drivebus.plant.config.whereabouts import state_of

    return state_of(plant)


async def _asked(folder: Path) -> dict[str, Any]:
    """Raises ServiceUnavailable: nobody is there; StopUnconfirmed: the plant hangs, or ended before it had told."""
    from drivebus.plant.socket_paths import LONGEST_LINE, STOP, STOP_WORD, reachable

    where = str(folder / STOP)
    try:
        with reachable(folder / STOP) as path:
            reader, writer = await asyncio.open_unix_connection(path, limit=LONGEST_LINE)
        writer.write(STOP_WORD)
    except OSError as error:
        raise ServiceUnavailable("stop_all.nobody", socket=where) from error
    try:
        heard = await asyncio.wait_for(reader.readline(), HEARD_S)
        line = await reader.readline() if heard else b""
        writer.close()
    except TimeoutError:
        raise StopUnconfirmed("stop_all.hangs", socket=where, seconds=HEARD_S) from None
    except OSError:
        line = b""
    if not line:
        raise StopUnconfirmed("stop_all.gone", socket=where)
    found: dict[str, Any] = json.loads(line)
    return found


def _tell(found: dict[str, Any]) -> Exit:
    left = [drive for bus in found["buses"].values() for drive in bus["unconfirmed"]]
    voice.document(found)
    if left:
        voice.tell("stop_all.unconfirmed", drives=", ".join(left))
        return Exit.UNKNOWN
    voice.tell("stop_all.confirmed", count=len(found["outcomes"]))
    return Exit.DONE


command = Verb(
    "stop-all",
    callback=_stop_all,
    params=[
        Argument(["plant"], metavar="[PLANT.toml]", required=False, key="help.argument.plant"),
        Option(["--directory"], metavar="DIR", example="--directory /var/lib/drivebus/plants/hall"),
    ],
    examples=("drivebus stop-all plant.toml", "drivebus stop-all --directory /var/lib/drivebus/plants/hall --json"),
)
