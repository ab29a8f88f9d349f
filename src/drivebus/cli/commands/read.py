"""``read``: parameters in the manual's notation, or signals by name; raw and scaled."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import click

from drivebus.cli import connect, output
from drivebus.cli.click_ext import Argument
from drivebus.cli.connect import Target
from drivebus.cli.drive_command import drive_command
from drivebus.cli.errors import ExitCode, error_json, print_error
from drivebus.cli.formatting import format_value, reading_json

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from drivebus.cli.dry_run import DryRun
    from drivebus.drives import Drive
    from drivebus.errors import DrivebusError, ProfileError
    from drivebus.profiles.model import Parameter, Signal
    from drivebus.values import Reading


_BETWEEN_NAMES = re.compile(r"[\s,;，、；]+")
"""What a user types between names; no name of a profile has it."""
_COMMA_IN_A_NAME = re.compile(r"\b([A-Za-z]+[0-9]*)[,，]([0-9]+)\b")
"""``F0,1`` for F0.1."""


async def _read(target: Target, names: tuple[str, ...]) -> ExitCode:
    """Read the known names; return 2 if a name is unknown. Opens no port where none is known."""
    from drivebus.profiles.notation import find_entries

    entries, unknown = find_entries(target.profile, names)
    rows: list[dict[str, Any]] = []
    silence: DrivebusError | None = None
    if entries:
        async with connect.open_drive(target) as (bus, drive):
            readings = await drive.read(list(entries))
            if target.service is None and _lack_replies(readings):
                readings, silence = await _read_again(drive, list(entries))
            now = bus.now()
        rows = [value_json(name, entries[name], readings[name], now) for name in entries]
    target_json = {"port": target.port, "model": target.model, "address": target.address}
    failure = error_json(silence)["error"] if silence else None
    output.print_json(target_json | {"values": rows, "refused": _refused_json(unknown.values()), "error": failure})
    if entries:
        output.print_text(values_table(rows, entries))
    for error in (*unknown.values(), *([silence] if silence else ())):
        print_error(error)
    if unknown:
        return ExitCode.USAGE
    return ExitCode.DONE if all(row["value"] is not None for row in rows) else ExitCode.FAILED


def _lack_replies(readings: Mapping[str, Reading]) -> bool:
    """Return whether the drive answered no read at all."""
    return all(reading.reason == "drives.no_answer" for reading in readings.values())


async def _read_again(drive: Drive, names: list[str]) -> tuple[dict[str, Reading], DrivebusError | None]:
    """Read once more, later. Return the readings, and why the drive does not answer where it does not."""
    from drivebus.errors import DrivebusError

    silence: DrivebusError | None = None
    try:
        await connect.read_again_later(drive.identify)
    except DrivebusError as error:
        silence = error
    readings = await drive.read(names)
    return readings, silence if _lack_replies(readings) else None


def _refused_json(unknown: Iterable[ProfileError]) -> list[dict[str, Any]]:
    return [error_json(error)["error"] for error in unknown]


def value_json(name: str, entry: Signal | Parameter, reading: Reading, now: float) -> dict[str, Any]:
    """Return a value with its notation, address on the wire, raw word, meaning and factory setting."""
    choices = getattr(entry, "choices", {})
    meaning = choices.get(reading.raw) if reading.raw is not None else None
    return {
        "name": name,
        "notation": entry.notation,
        "text": output.to_json_value(entry.text),
        "wire": {"space": entry.locator[0], "address": entry.locator[1], "hex": f"{entry.locator[1]:04X}H"},
        "raw": reading.raw,
        "raw_hex": None if reading.raw is None else f"{reading.raw:04X}H",
        "meaning": output.to_json_value(meaning) if meaning else None,
        "factory": getattr(entry, "factory", None),
    } | reading_json(reading, now)


def values_table(rows: list[dict[str, Any]], entries: dict[str, Signal | Parameter]) -> str:
    """Format the values as a table."""
    head = [output.text(f"read.{name}") for name in ("notation", "wire", "raw", "value", "text")]
    return output.fitted_table(head, [_cells(row, entries[row["name"]]) for row in rows])


def _cells(row: dict[str, Any], entry: Signal | Parameter) -> list[str]:
    meaning = f" = {row['meaning']}" if row["meaning"] else ""
    factory = ""
    if row["factory"] is not None:
        shown = format_value(row["factory"], row["unit"], entry)
        factory = output.text("status.because", why=output.text("read.factory", value=shown))
    reason = output.text("status.because", why=row["reason"]) if row.get("reason") else ""
    wire = f"{output.text('read.space_' + row['wire']['space'])} {row['wire']['hex']}"
    value = format_value(row["value"], row["unit"], entry)
    return [row["notation"], wire, row["raw_hex"] or "–", value, row["text"] + meaning + factory + reason]


def _reject_joined_names(ctx: click.Context, param: click.Parameter, names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names. Raises BadParameter where a comma joins some: they are separated by blanks."""
    if assigned := next((name for name in names if "=" in name), None):
        raise click.BadParameter(output.text("read.assigned", found=assigned), ctx, param)
    joined = [name for name in names if _BETWEEN_NAMES.search(name.strip())]
    if joined:
        with_points = _COMMA_IN_A_NAME.sub(r"\1.\2", " ".join(names))
        apart = " ".join(filter(None, _BETWEEN_NAMES.split(with_points)))
        raise click.BadParameter(output.text("read.joined", found=" ".join(names), names=apart), ctx, param)
    return names


def _plan(dry: DryRun, names: tuple[str, ...]) -> ExitCode:
    from drivebus.profiles.model import Parameter
    from drivebus.profiles.notation import find_entries

    entries, unknown = find_entries(dry.dialect.profile, names)
    for entry in entries.values():
        if isinstance(entry, Parameter):
            dry.add("read", [dry.dialect.read_parameter(entry)])
        else:
            dry.add("signals", [request for request, _ in dry.dialect.polls((entry.name,))])
    code = dry.print(*(["dry.note.sync"] if entries else ()), refused=_refused_json(unknown.values()))
    for error in unknown.values():
        print_error(error)
    return ExitCode.USAGE if unknown else code


command = drive_command(
    "read",
    _read,
    _plan,
    extra=(Argument(["names"], nargs=-1, required=True, metavar="NAME...", callback=_reject_joined_names),),
    examples=(
        "drivebus read /dev/ttyUSB0 F0.1 F9.4 output_frequency --model c320 --address 1",
        "drivebus read sim://vc660@3 F00.02 3006H --model vc660 --address 3 --json",
        "drivebus read /dev/ttyUSB0 10 Q01 --model dzb100 --address 5 --dry-run",
        "drivebus read --service http://127.0.0.1:8080 --drive fan-1 F0.1 F9.4",
    ),
)
