"""``hold-ramp``: keep the output frequency where it is for some seconds."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivebus.cli import connect, options, output
from drivebus.cli.click_ext import Argument
from drivebus.cli.connect import Target
from drivebus.cli.drive_command import drive_command, print_outcome, stop_and_print
from drivebus.cli.errors import ExitCode

if TYPE_CHECKING:
    from drivebus.cli.dry_run import DryRun


async def _hold(target: Target, seconds: float) -> ExitCode:
    from drivebus.cli.signals import shutdown_signals
    from drivebus.drives.dialects.base import Hold

    with output.continue_without_output(), shutdown_signals(may_suspend=False) as shutdown:
        async with connect.open_drive(target) as (bus, drive):
            if Hold.RAMP.value in drive.profile.capabilities:  # else the command is refused
                output.print_message("hold_ramp.how", seconds=seconds)
            outcome = await shutdown.interruptible(drive.hold_ramp(seconds))
            if outcome is None:
                return await stop_and_print(bus, drive, ExitCode.INTERRUPTED)
            return print_outcome(outcome, bus.now())


def _plan(dry: DryRun, seconds: float) -> ExitCode:
    from drivebus.drives.dialects.base import Hold, StopMode
    from drivebus.drives.operations.hold import check_ramp_hold

    check_ramp_hold(dry.drive, seconds)
    dry.add_readiness()
    dry.add("hold_ramp", [dry.dialect.hold(Hold.RAMP).request])
    dry.add("end_hold", [dry.dialect.end_hold().request])
    dry.add("stop", dry.dialect.stop(StopMode.STOP))
    return dry.print("dry.note.hold", "dry.note.fewer", "dry.note.confirm")


command = drive_command(
    "hold-ramp",
    _hold,
    _plan,
    stays_attached=True,
    extra=(Argument(["seconds"], metavar="SECONDS", type=options.HOLD_TIME),),
    examples=(
        "drivebus hold-ramp /dev/ttyUSB0 5 --model vc660 --address 3",
        "drivebus hold-ramp --service http://127.0.0.1:8080 --drive pump-2 5",
    ),
)
