"""``set-frequency``: change the set frequency; starts nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivebus.cli import options
from drivebus.cli.command import Argument
from drivebus.cli.connect import Target
from drivebus.cli.drive_verb import command as send
from drivebus.cli.drive_verb import drive_verb
from drivebus.cli.exits import Exit

if TYPE_CHECKING:
    from drivebus.cli.dry import DryRun


async def _set(target: Target, frequency_hz: float) -> Exit:
    return await send(target, lambda drive: drive.set_frequency(frequency_hz))


def _plan(dry: DryRun, frequency_hz: float) -> Exit:
    from drivebus.drives.book import Book

    frames = dry.dialect.set_frequency(dry.dialect.setpoint_word(frequency_hz), Book())
    dry.add("set_frequency", [frame.request for frame in frames])
    return dry.show("dry.note.confirm")


command = drive_verb(
    "set-frequency",
    _set,
    _plan,
    extra=(Argument(["frequency_hz"], metavar="HZ", type=options.FREQUENCY),),
    examples=(
        "drivebus set-frequency /dev/ttyUSB0 25 --model c320 --address 1",
        "drivebus set-frequency /dev/ttyUSB0 12.5 --model vc660 --address 3 --dry-run",
    ),
)
