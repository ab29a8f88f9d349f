"""``stop``: stop a drive and confirm it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from drivebus.cli.connect import Target
from drivebus.cli.drive_verb import command as send
from drivebus.cli.drive_verb import drive_verb, simple
from drivebus.cli.exits import Exit

if TYPE_CHECKING:
    from drivebus.cli.dry import DryRun


async def _stop(target: Target) -> Exit:
    return await send(target, lambda drive: drive.stop(wait=True))


def _requests(dry: DryRun) -> Any:
    from drivebus.drives.dialect import Stop

    return dry.dialect.stop(Stop.STOP)


command = drive_verb(
    "stop",
    _stop,
    simple("stop", _requests, "dry.note.confirm"),
    examples=(
        "drivebus stop /dev/ttyUSB0 --model c320 --address 1",
        "drivebus stop sim://vc660@3 --model vc660 --address 3 --json",
        "drivebus stop --service http://127.0.0.1:8080 --drive fan-1",
    ),
)
