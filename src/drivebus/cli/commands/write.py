"""``write``: write parameters, to RAM unless ``--save``, and read each back."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from drivebus.cli import options
from drivebus.cli.click_ext import Argument, Option
from drivebus.cli.connect import Target
from drivebus.cli.drive_command import drive_command, run_command
from drivebus.cli.errors import ExitCode

if TYPE_CHECKING:
    from drivebus.cli.dry_run import DryRun
    from drivebus.profiles.model import Parameter

Assignments = tuple[tuple[str, float], ...]


def parse_parameter_assignment(text: str) -> tuple[str, float]:
    """Parse ``F1.07=10.0``. Raises ValueError."""
    name, value = options.parse_assignment(text)
    return name, float(value)


async def _write(target: Target, settings: Assignments, save: bool, eeprom_writes_per_day: int | None) -> ExitCode:
    from drivebus.drives import DriveLimits

    limits = None if eeprom_writes_per_day is None else DriveLimits(eeprom_writes_per_day=eeprom_writes_per_day)
    return await run_command(target, lambda drive: drive.write(dict(settings), save=save), limits)


def _plan(dry: DryRun, settings: Assignments, save: bool, eeprom_writes_per_day: int | None) -> ExitCode:
    from drivebus.errors import ConfigurationError
    from drivebus.profiles.model import Parameter
    from drivebus.profiles.notation import find_entry

    for name, value in settings:
        entry = find_entry(dry.dialect.profile, name)
        if not isinstance(entry, Parameter):
            raise ConfigurationError("cli.not_a_parameter", name=name)
        if save and entry.readable:
            dry.add("compare", [dry.dialect.read_parameter(entry)])
        dry.add("write", [dry.dialect.write_parameter(entry, _word(dry, entry, value), save).request])
        if entry.readable:
            dry.add("verify", [dry.dialect.read_parameter(entry)])
    return dry.print("dry.note.sync")


def _word(dry: DryRun, parameter: Parameter, value: float) -> int:
    from drivebus.errors import LimitError

    try:
        return dry.dialect.parameter_word(parameter, value)
    except ValueError as error:
        raise LimitError("drives.parameter_word", notation=parameter.notation, value=value) from error


command = drive_command(
    "write",
    _write,
    _plan,
    extra=(
        Argument(
            ["settings"],
            nargs=-1,
            required=True,
            metavar="NAME=VALUE...",
            type=options.ParsedType("assignment", parse_parameter_assignment, "cli.expect.assignment"),
        ),
        Option(["--save"], is_flag=True),
        Option(
            ["--eeprom-writes-per-day"],
            type=options.CheckedType(click.IntRange(min=0), "cli.expect.whole_number"),
            metavar="N",
            example="--eeprom-writes-per-day 50",
        ),
    ),
    examples=(
        "drivebus write /dev/ttyUSB0 F1.10=1 --model c320 --address 1",
        "drivebus write /dev/ttyUSB0 F1.07=10.0 F1.08=12.5 --save --model df800 --address 2",
        "drivebus write /dev/ttyUSB0 10=15.0 --save --model dzb100 --address 5 --dry-run",
        "drivebus write --service http://127.0.0.1:8080 --drive fan-1 F1.10=1",
    ),
)
