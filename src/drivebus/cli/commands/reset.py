"""``reset``: reset a fault once, then read whether it is gone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from drivebus.cli.connect import Target
from drivebus.cli.drive_command import drive_command, run_command
from drivebus.cli.errors import ExitCode

if TYPE_CHECKING:
    from drivebus.cli.dry_run import DryRun


async def _reset(target: Target) -> ExitCode:
    return await run_command(target, lambda drive: drive.reset_fault())


def _plan(dry: DryRun, **_: Any) -> ExitCode:
    from drivebus.drives.dialects.base import StopMode

    commands = dry.dialect.profile.commands
    frames, state_reads = dry.dialect.reset(), dry.dialect.state_reads()
    dry.add("state", state_reads)
    dry.add_unlock()
    if commands is not None and commands.reset_on_edge:
        dry.add("stop", dry.dialect.stop(StopMode.STOP))
    dry.add("reset", [frame.request for frame in frames])
    return dry.print(*(("dry.note.reset",) if state_reads else ()), "dry.note.confirm")


command = drive_command(
    "reset",
    _reset,
    _plan,
    examples=(
        "drivebus reset /dev/ttyUSB0 --model c320 --address 1",
        "drivebus reset --service http://127.0.0.1:8080 --drive fan-1",
    ),
)
