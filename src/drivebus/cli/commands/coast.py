"""``coast``: switch the output off; the motor coasts to rest."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivebus.cli.connect import Target
from drivebus.cli.drive_command import drive_command, run_command
from drivebus.cli.errors import ExitCode

if TYPE_CHECKING:
    from drivebus.cli.dry_run import DryRun


async def _coast(target: Target) -> ExitCode:
    return await run_command(target, lambda drive: drive.coast())


def _plan(dry: DryRun) -> ExitCode:
    from drivebus.drives.dialects.base import StopMode

    dry.add_model_check()
    dry.add("coast", dry.dialect.stop(StopMode.COAST))
    return dry.print("dry.note.confirm")


command = drive_command(
    "coast",
    _coast,
    _plan,
    stops=True,
    examples=(
        "drivebus coast /dev/ttyUSB0 --model vc660 --address 3",
        "drivebus coast --service http://127.0.0.1:8080 --drive pump-2",
    ),
)
