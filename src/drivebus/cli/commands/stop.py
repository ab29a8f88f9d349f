"""``stop``: stop a drive and confirm it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from drivebus.cli.connect import Target
from drivebus.cli.drive_command import drive_command, single_step_plan
from drivebus.cli.drive_command import run_command as send
from drivebus.cli.errors import ExitCode

if TYPE_CHECKING:
    from drivebus.cli.dry_run import DryRun


async def _stop(target: Target) -> ExitCode:
    return await send(target, lambda drive: drive.stop(wait=True))


def _requests(dry: DryRun) -> Any:
    from drivebus.drives.dialects.base import StopMode

    return dry.dialect.stop(StopMode.STOP)


command = drive_command(
    "stop",
    _stop,
    single_step_plan("stop", _requests, "dry.note.confirm"),
    examples=(
        "drivebus stop /dev/ttyUSB0 --model c320 --address 1",
        "drivebus stop sim://vc660@3 --model vc660 --address 3 --json",
        "drivebus stop --service http://127.0.0.1:8080 --drive fan-1",
    ),
)
