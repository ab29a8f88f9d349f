"""``set-frequency``: change the set frequency without a start."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivebus.cli import options
from drivebus.cli.click_ext import Argument
from drivebus.cli.connect import Target
from drivebus.cli.drive_command import drive_command, run_command
from drivebus.cli.errors import ExitCode

if TYPE_CHECKING:
    from drivebus.cli.dry_run import DryRun
    from drivebus.drives.readings import ReadingPairs


async def _set(target: Target, frequency_hz: float) -> ExitCode:
    return await run_command(target, lambda drive: drive.set_frequency(frequency_hz))


async def _set_group(service: str, group: str, frequency_hz: float) -> ExitCode:
    """Set the frequency of the leader, or of every drive of a group without one; followers get their ratio of it."""
    from drivebus.cli.remote.group import command_group, print_outcomes_by_drive
    from drivebus.service.api.operations.groups import GROUP_SET_FREQUENCY

    return print_outcomes_by_drive(await command_group(service, GROUP_SET_FREQUENCY, group, frequency_hz=frequency_hz))


def _plan(dry: DryRun, frequency_hz: float) -> ExitCode:
    """Print the frames for a stopped drive, or for a running one if the frequency needs a run command."""
    from drivebus.drives.operations.setpoint import check_set_frequency
    from drivebus.drives.readings import ReadingPairs
    from drivebus.errors import StartInhibited

    dry.check_then_assume_scale(lambda: check_set_frequency(dry.drive, frequency_hz))
    word, as_if = dry.dialect.setpoint_word(frequency_hz), False
    try:
        frames = dry.dialect.set_frequency(word, ReadingPairs())
    except StartInhibited:
        frames, as_if = dry.dialect.set_frequency(word, _running()), True
    dry.add_readiness()
    dry.add("set_frequency", [frame.request for frame in frames])
    return dry.print(*(("dry.note.as_if_running",) if as_if else ()), "dry.note.fewer", "dry.note.confirm")


def _running() -> ReadingPairs:
    """Return readings of a drive that twice reported the command run forward."""
    from drivebus.drives.readings import ReadingPairs
    from drivebus.values import Reading

    readings = ReadingPairs()
    for _ in range(2):
        readings.add({"command": Reading(value=1, raw=1)})
    return readings


command = drive_command(
    "set-frequency",
    _set,
    _plan,
    on_group=_set_group,
    extra=(Argument(["frequency_hz"], metavar="HZ", type=options.FREQUENCY),),
    examples=(
        "drivebus set-frequency /dev/ttyUSB0 25 --model c320 --address 1",
        "drivebus set-frequency /dev/ttyUSB0 12.5 --model vc660 --address 3 --dry-run",
        "drivebus set-frequency --service http://127.0.0.1:8080 --drive fan-1 25",
        "drivebus set-frequency --service http://127.0.0.1:8080 --group fans 25",
    ),
)
