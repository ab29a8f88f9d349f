"""``coast``: switch the output off; the motor coasts to rest."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from drivebus.cli.connect import Target
from drivebus.cli.drive_command import drive_command, run_command, single_step_plan
from drivebus.cli.errors import ExitCode

if TYPE_CHECKING:
    from drivebus.cli.dry_run import DryRun


async def _coast(target: Target) -> ExitCode:
    return await run_command(target, lambda drive: drive.coast())


def _requests(dry: DryRun) -> Any:
    from drivebus.drives.dialects.base import StopMode

    dry.add_model_check()
    return dry.dialect.stop(StopMode.COAST)


command = drive_command(
    "coast",
    _coast,
    single_step_plan("coast", _requests, "dry.note.confirm"),
    stops=True,
    examples=(
        "drivebus coast /dev/ttyUSB0 --model vc660 --address 3",
        "drivebus coast --service http://127.0.0.1:8080 --drive pump-2",
    ),
)
