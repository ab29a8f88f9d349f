"""``reset``: reset a fault once, then read whether it is gone."""

from __future__ import annotations

from drivebus.cli.connect import Target
from drivebus.cli.drive_command import drive_command, run_command, single_step_plan
from drivebus.cli.errors import ExitCode


async def _reset(target: Target) -> ExitCode:
    return await run_command(target, lambda drive: drive.reset_fault())


command = drive_command(
    "reset",
    _reset,
    single_step_plan("reset", lambda dry: [frame.request for frame in dry.dialect.reset()], "dry.note.confirm"),
    examples=(
        "drivebus reset /dev/ttyUSB0 --model c320 --address 1",
        "drivebus reset --service http://127.0.0.1:8080 --drive fan-1",
    ),
)
