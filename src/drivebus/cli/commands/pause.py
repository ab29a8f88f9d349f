"""``pause``: pause a run; a start lets the motor run again."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivebus.cli.connect import Target
from drivebus.cli.drive_command import drive_command, run_command
from drivebus.cli.errors import ExitCode

if TYPE_CHECKING:
    from drivebus.cli.dry_run import DryRun


async def _pause(target: Target) -> ExitCode:
    return await run_command(target, lambda drive: drive.pause())


def _plan(dry: DryRun) -> ExitCode:
    from drivebus.drives.dialects.base import Hold

    dry.drive.require_capability(Hold.PAUSE.value)
    dry.add("state", dry.dialect.state_reads())
    dry.add("pause", [dry.dialect.hold(Hold.PAUSE).request])
    return dry.print("dry.note.confirm")


command = drive_command(
    "pause",
    _pause,
    _plan,
    examples=(
        "drivebus pause /dev/ttyUSB0 --model vc660 --address 3",
        "drivebus pause --service http://127.0.0.1:8080 --drive pump-2",
    ),
)
