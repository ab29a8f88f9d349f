"""``scan``: find drives. Reads only; listens first; keeps what it found when it is interrupted."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

from drivebus.cli import options, voice
from drivebus.cli.command import Option, Verb
from drivebus.cli.connect import recording
from drivebus.cli.exits import Exit
from drivebus.cli.progress import duration
from drivebus.cli.scan_page import Meter, show, show_plan

if TYPE_CHECKING:
    from drivebus.cli.ending import Ending
    from drivebus.commissioning.scan import Overheard
    from drivebus.commissioning.scan_plan import Pass
    from drivebus.line import LineSettings
    from drivebus.ports.port import Port

DEFAULT_MODELS = ("c320", "dzb100", "vc660", "df800")


def words(text: str) -> tuple[str, ...]:
    """``a,b`` → (a, b). Raises ValueError where nothing is left."""
    found = tuple(part.strip() for part in text.split(",") if part.strip())
    if not found:
        raise ValueError(text)
    return found


def bauds(text: str) -> tuple[int, ...]:
    """``9600,19200``. Raises ValueError."""
    found = tuple(int(part) for part in words(text))
    if any(not 50 <= baud <= 4_000_000 for baud in found):
        raise ValueError(text)
    return found


def formats(text: str) -> tuple[str, ...]:
    """``8N1,8E1``. Raises ValueError."""
    from drivebus.line import LineSettings

    return tuple(LineSettings.parse(9600, part).format for part in words(text))


def _scan(
    link: str,
    models: tuple[str, ...],
    addresses: tuple[int, ...] | None,
    bauds: tuple[int, ...] | None,
    formats: tuple[str, ...] | None,
    encoding: str | None,
    listen: float,
    anyway: bool,
    everything: bool,
    record: str | None,
    dry_run: bool,
) -> Exit:
    passes = make_plan(link, models, addresses, bauds, formats, encoding)
    if dry_run:
        return show_plan(passes)
    with recording(record) as around:
        return asyncio.run(_run(link, passes, listen, anyway, everything, around))


def make_plan(
    link: str,
    models: tuple[str, ...],
    addresses: tuple[int, ...] | None,
    bauds: tuple[int, ...] | None,
    formats: tuple[str, ...] | None,
    encoding: str | None,
) -> list[Pass]:
    """What will be asked. A LINK with ``?baud=`` or ``&format=`` has chosen, and so has a raw TCP server."""
    from drivebus import ports, profiles
    from drivebus.commissioning.scan_plan import FIXED_LINE, plan
    from drivebus.ports.link import parse_link

    parsed = parse_link(link)
    fixed = ports.open_port(link).settings if parsed.scheme in FIXED_LINE else None
    return plan(
        [profiles.load(model) for model in models],
        addresses=addresses,
        bauds=bauds or ((parsed.settings.baud,) if "baud" in parsed.given else None),
        formats=formats or ((parsed.settings.format,) if "format" in parsed.given else None),
        encodings=(encoding,) if encoding else None,
        fixed=fixed,
    )


async def _run(
    link: str, passes: list[Pass], listen_s: float, anyway: bool, everything: bool, around: Callable[[Port], Port]
) -> Exit:
    from drivebus import ports
    from drivebus.cli.ending import listening
    from drivebus.commissioning import scan
    from drivebus.errors import DrivebusError

    def open_port(settings: LineSettings) -> Port:
        return around(ports.open_port(link, baud=settings.baud, format=settings.format))

    progress = scan.Progress(sum(one.seconds for one in passes))
    with listening() as ending:
        overheard = await _listen(ending, open_port, passes, listen_s) if listen_s > 0 and passes else None
        if overheard is not None and overheard.count:
            voice.note("scan.foreign", count=overheard.count, seconds=f"{overheard.seconds:g}")
            if not anyway:
                voice.note("scan.foreign_end")
                return show(link, progress, overheard, Exit.REFUSED)
        voice.note("scan.feeds", time=duration(progress.total_s))
        try:
            with Meter() as meter:
                walk = scan.scan(passes, open_port, progress, meter.tell, keep_going=everything)
                await ending.race(walk)
        except DrivebusError:
            show(link, progress, overheard, Exit.REFUSED)
            raise
    if ending.come:
        voice.note("scan.aborted")
    code = Exit.INTERRUPTED if ending.come else Exit.DONE if progress.found else Exit.REFUSED
    return show(link, progress, overheard, code)


async def _listen(ending: Ending, open_port: Any, passes: list[Pass], seconds: float) -> Overheard | None:
    """Say nothing first. Raises PortUnavailable."""
    from drivebus.commissioning.scan import listen

    voice.note("scan.listening", seconds=f"{seconds:g}")
    return await ending.race(listen(open_port(passes[0].settings), seconds))


def searched() -> list[click.Parameter]:
    """--models and --addresses: whom a scan asks."""
    models = options.Parsed("models", words, "cli.expect.models")
    usual = ",".join(DEFAULT_MODELS)
    return [
        Option(["--models"], default=usual, type=models, metavar="M,...", example="--models c320,vc660"),
        Option(["--addresses"], type=options.ADDRESSES, metavar="N,...", example="--addresses 1-8"),
    ]


def listen_first() -> click.Option:
    """--listen: so long a scan only listens."""
    key = "help.option.listen_first"
    seconds = options.Number(0.0, 86_400.0)
    return Option(["--listen"], type=seconds, default=2.0, metavar="S", key=key, example="--listen 5")


command = Verb(
    "scan",
    callback=_scan,
    params=[
        options.link(),
        *searched(),
        Option(
            ["--bauds"],
            type=options.Parsed("bauds", bauds, "cli.expect.bauds"),
            metavar="B,...",
            example="--bauds 9600,19200",
        ),
        Option(
            ["--formats"],
            type=options.Parsed("formats", formats, "cli.expect.formats"),
            metavar="F,...",
            example="--formats 8N1,8E1",
        ),
        options.encoding(),
        listen_first(),
        Option(["--anyway"], is_flag=True),
        Option(["--all", "everything"], is_flag=True, key="help.option.all"),
        options.record(),
        options.dry_run(),
    ],
    examples=(
        "drivebus scan /dev/ttyUSB0",
        "drivebus scan /dev/ttyUSB0 --models c320 --addresses 1-8 --bauds 9600 --formats 8E1,8N1",
        "drivebus scan sim://vc660@3 --models vc660 --addresses 1-5 --json",
        "drivebus scan tcp://192.168.1.50:4001 --dry-run",
        "drivebus scan /dev/ttyUSB0 --record what-answered.dbcap",
    ),
)
