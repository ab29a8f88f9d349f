"""``read``: parameters in the manual's own notation, or signals by name; raw and scaled."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from drivebus.cli import connect, voice
from drivebus.cli.command import Argument
from drivebus.cli.connect import Target
from drivebus.cli.drive_verb import drive_verb
from drivebus.cli.exits import Exit
from drivebus.profiles.model import DriveProfile, Parameter, Signal

if TYPE_CHECKING:
    from drivebus.cli.dry import DryRun
    from drivebus.reading import Reading


async def _read(target: Target, names: tuple[str, ...]) -> Exit:
    profile = target.profile()
    entries = {name: found(profile, name) for name in names}
    async with connect.drive(target) as (bus, drive):
        readings = await drive.read(list(names))
        now = bus.now()
    rows = [row(name, entries[name], readings[name], now) for name in names]
    voice.document({"link": target.link, "model": target.model, "address": target.address, "values": rows})
    voice.show(table_of(rows, entries))
    return Exit.DONE if all(one["value"] is not None for one in rows) else Exit.REFUSED


def found(profile: DriveProfile, name: str) -> Signal | Parameter:
    """What ``name`` means in this profile. Raises ProfileError with the nearest names."""
    from drivebus.profiles.notation import find

    return find(profile, name)


def row(name: str, entry: Signal | Parameter, reading: Reading, now: float) -> dict[str, Any]:
    """One value with everything that is known of it."""
    from drivebus.cli.live.model import reading_document

    choices = getattr(entry, "choices", {})
    meaning = choices.get(reading.raw) if reading.raw is not None else None
    return {
        "name": name,
        "notation": entry.notation,
        "text": voice.plain(entry.text),
        "wire": {"space": entry.locator[0], "address": entry.locator[1], "hex": f"{entry.locator[1]:04X}H"},
        "raw": reading.raw,
        "raw_hex": None if reading.raw is None else f"{reading.raw:04X}H",
        "meaning": voice.plain(meaning) if meaning else None,
    } | reading_document(reading, now)


def table_of(rows: list[dict[str, Any]], entries: dict[str, Signal | Parameter]) -> str:
    """The values for people."""
    head = [voice.say(f"read.{name}") for name in ("notation", "wire", "raw", "value", "text")]
    return voice.grid(head, [_cells(one, entries[one["name"]]) for one in rows])


def _cells(one: dict[str, Any], entry: Signal | Parameter) -> list[str]:
    from drivebus.cli.figures import figure

    meaning = f" = {one['meaning']}" if one["meaning"] else ""
    reason = voice.say("status.because", why=one["reason"]) if one.get("reason") else ""
    wire = f"{voice.say('read.space_' + one['wire']['space'])} {one['wire']['hex']}"
    value = figure(one["value"], one["unit"], entry)
    return [one["notation"], wire, one["raw_hex"] or "–", value, one["text"] + meaning + reason]


def _plan(dry: DryRun, names: tuple[str, ...]) -> Exit:
    for name in names:
        entry = found(dry.dialect.profile, name)
        if isinstance(entry, Parameter):
            dry.add("read", [dry.dialect.read_parameter(entry)])
        else:
            dry.add("signals", [request for request, _ in dry.dialect.polls((entry.name,))])
    return dry.show("dry.note.fence")


command = drive_verb(
    "read",
    _read,
    _plan,
    extra=(Argument(["names"], nargs=-1, required=True, metavar="NAME..."),),
    examples=(
        "drivebus read /dev/ttyUSB0 F0.1 F9.4 output_frequency --model c320 --address 1",
        "drivebus read sim://vc660@3 F00.02 3006H --model vc660 --address 3 --json",
        "drivebus read /dev/ttyUSB0 10 Q01 --model dzb100 --address 5 --dry-run",
        "drivebus read --service http://127.0.0.1:8080 --drive fan-1 F0.1 F9.4",
    ),
)
