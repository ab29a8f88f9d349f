"""``write``: write parameters, to RAM unless ``--save``, and read each back."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivebus.cli import options
from drivebus.cli.click_ext import Argument, Option
from drivebus.cli.connect import Target
from drivebus.cli.drive_command import drive_command, run_command
from drivebus.cli.errors import ExitCode

if TYPE_CHECKING:
    from drivebus.cli.dry_run import DryRun

Assignments = tuple[tuple[str, float | str], ...]


def parse_parameter_assignment(text: str) -> tuple[str, float | str]:
    """Parse ``F1.07=10.0`` or ``F1.10=0010H``. Raises ValueError."""
    from drivebus.profiles.notation import parse_value

    name, value = options.parse_assignment(text)
    return name, parse_value(value)


async def _write(
    target: Target, settings: Assignments, *, save: bool, force: bool, eeprom_writes_per_day: int | None
) -> ExitCode:
    from drivebus.drives import DriveLimits

    limits = None if eeprom_writes_per_day is None else DriveLimits(eeprom_writes_per_day=eeprom_writes_per_day)
    return await run_command(target, lambda drive: drive.write(dict(settings), save=save, force=force), limits)


def _plan(
    dry: DryRun, settings: Assignments, *, save: bool, force: bool, eeprom_writes_per_day: int | None
) -> ExitCode:
    from drivebus.drives.operations.parameter_write import check_writes, confirmation_needed

    for write in check_writes(dry.dialect, dict(settings)):
        read = [dry.dialect.read_parameter(write.parameter)] if write.parameter.readable else []
        if save:
            dry.add("compare", read)
        dry.add("write", [dry.dialect.write_parameter(write.parameter, write.raw, save=save).request])
        dry.add("verify", read)
        needed = confirmation_needed(dry.dialect, write)
        if needed is not None and not force:
            raise needed
    return dry.print("dry.note.sync")


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
            callback=options.reject_second_value,
        ),
        Option(["--save"], is_flag=True),
        Option(["--force"], is_flag=True, key="help.option.write_force"),
        Option(
            ["--eeprom-writes-per-day"],
            type=options.CheckedType(options.NumberType(0, 1_000_000), "cli.expect.whole_number"),
            metavar="N",
            example="--eeprom-writes-per-day 50",
        ),
    ),
    examples=(
        "drivebus write /dev/ttyUSB0 F1.10=0010 --model c320 --address 1",
        "drivebus write /dev/ttyUSB0 F1.07=10 F1.08=15 --save --model df800 --address 2",
        "drivebus write /dev/ttyUSB0 10=15 --save --model dzb100 --address 5 --dry-run",
        "drivebus write --service http://127.0.0.1:8080 --drive fan-1 F1.10=1",
    ),
)
