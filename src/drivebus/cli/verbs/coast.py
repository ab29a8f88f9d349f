"""``coast``: switch the output off; the motor runs out by itself."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from drivebus.cli.connect import Target
from drivebus.cli.drive_verb import command as send
from drivebus.cli.drive_verb import drive_verb, simple
from drivebus.cli.exits import Exit

if TYPE_CHECKING:
    from drivebus.cli.dry import DryRun


async def _coast(target: Target) -> Exit:
    return await send(target, lambda drive: drive.coast())


def _requests(dry: DryRun) -> Any:
    from drivebus.drives.dialect import Stop

    return dry.dialect.stop(Stop.COAST)


command = drive_verb(
    "coast",
    _coast,
    simple("coast", _requests, "dry.note.confirm"),
    examples=(
        "drivebus coast /dev/ttyUSB0 --model vc660 --address 3",
        "drivebus coast --service http://127.0.0.1:8080 --drive pump-2",
    ),
)
