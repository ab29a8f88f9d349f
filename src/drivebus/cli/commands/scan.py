"""``scan``: find drives. Reads only; listens first; keeps what it found when it is interrupted."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

from drivebus.cli import options, output
from drivebus.cli.click_ext import CliCommand, Option
from drivebus.cli.connect import record_ports
from drivebus.cli.errors import ExitCode
from drivebus.cli.progress import format_duration
from drivebus.cli.scanning import ScanProgressBar, print_scan, print_scan_plan

if TYPE_CHECKING:
    from drivebus.cli.signals import ShutdownSignal
    from drivebus.commissioning.scan import ScanPass, SniffResult
    from drivebus.ports.base import Port
    from drivebus.serial_settings import SerialSettings


def parse_words(text: str) -> tuple[str, ...]:
    """``a,b`` → (a, b). Raises ValueError where nothing is left."""
    found = tuple(part.strip() for part in text.split(",") if part.strip())
    if not found:
        raise ValueError(text)
    return found


def parse_bauds(text: str) -> tuple[int, ...]:
    """``9600,19200``. Raises ValueError."""
    found = tuple(int(part) for part in parse_words(text))
    if any(not 50 <= baud <= 4_000_000 for baud in found):
        raise ValueError(text)
    return found


def parse_formats(text: str) -> tuple[str, ...]:
    """``8N1,8E1``. Raises ValueError."""
    from drivebus.serial_settings import SerialSettings

    return tuple(SerialSettings.parse(9600, part).format for part in parse_words(text))


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
) -> ExitCode:
    passes = make_plan(link, models, addresses, bauds, formats, encoding)
    if dry_run:
        return print_scan_plan(passes)
    with record_ports(record) as around:
        return asyncio.run(_run(link, passes, listen, anyway, everything, around))


def make_plan(
    link: str,
    models: tuple[str, ...],
    addresses: tuple[int, ...] | None,
    bauds: tuple[int, ...] | None,
    formats: tuple[str, ...] | None,
    encoding: str | None,
) -> list[ScanPass]:
    """What will be asked. A LINK with ``?baud=`` or ``&format=`` has chosen, and so has a raw TCP server."""
    from drivebus import ports, profiles
    from drivebus.commissioning.scan import FIXED_SETTINGS_SCHEMES, plan_scan
    from drivebus.ports.url import parse_port_url

    parsed = parse_port_url(link)
    fixed = ports.open_port(link).settings if parsed.scheme in FIXED_SETTINGS_SCHEMES else None
    return plan_scan(
        [profiles.load(model) for model in models],
        addresses=addresses,
        bauds=bauds or ((parsed.settings.baud,) if "baud" in parsed.explicit else None),
        formats=formats or ((parsed.settings.format,) if "format" in parsed.explicit else None),
        encodings=(encoding,) if encoding else None,
        fixed=fixed,
    )


async def _run(
    link: str, passes: list[ScanPass], listen_s: float, anyway: bool, everything: bool, around: Callable[[Port], Port]
) -> ExitCode:
    from drivebus import ports
    from drivebus.cli.signals import shutdown_signals
    from drivebus.commissioning import scan
    from drivebus.errors import DrivebusError

    def open_port(settings: SerialSettings) -> Port:
        return around(ports.open_port(link, baud=settings.baud, format=settings.format))

    progress = scan.ScanProgress(sum(one.duration_s for one in passes))
    with shutdown_signals() as ending:
        overheard = await _listen(ending, open_port, passes, listen_s) if listen_s > 0 and passes else None
        if overheard is not None and overheard.count:
            output.print_note("scan.foreign", count=overheard.count, seconds=f"{overheard.seconds:g}")
            if not anyway:
                output.print_note("scan.foreign_end")
                return print_scan(link, progress, overheard, ExitCode.FAILED)
        output.print_note("scan.feeds", time=format_duration(progress.total_s))
        try:
            with ScanProgressBar() as meter:
                walk = scan.scan(passes, open_port, progress, meter.on_progress, keep_going=everything)
                await ending.interruptible(walk)
        except DrivebusError:
            print_scan(link, progress, overheard, ExitCode.FAILED)
            raise
    if ending.received:
        output.print_note("scan.aborted")
    code = ExitCode.INTERRUPTED if ending.received else ExitCode.DONE if progress.found else ExitCode.FAILED
    return print_scan(link, progress, overheard, code)


async def _listen(ending: ShutdownSignal, open_port: Any, passes: list[ScanPass], seconds: float) -> SniffResult | None:
    """Say nothing first. Raises PortUnavailable."""
    from drivebus.commissioning.scan import sniff

    output.print_note("scan.listening", seconds=f"{seconds:g}")
    return await ending.interruptible(sniff(open_port(passes[0].settings), seconds))


def search_options() -> list[click.Parameter]:
    """--models and --addresses: whom a scan asks."""
    from drivebus.protocols.family import default_scan_models

    models = options.ParsedType("models", parse_words, "cli.expect.models")
    usual = ",".join(default_scan_models())
    return [
        Option(["--models"], default=usual, type=models, metavar="M,...", example="--models c320,vc660"),
        Option(["--addresses"], type=options.ADDRESSES, metavar="N,...", example="--addresses 1-8"),
    ]


def listen_option() -> click.Option:
    """--listen: so long a scan only listens."""
    key = "help.option.listen_first"
    seconds = options.NumberType(0.0, 86_400.0)
    return Option(["--listen"], type=seconds, default=2.0, metavar="S", key=key, example="--listen 5")


command = CliCommand(
    "scan",
    callback=_scan,
    params=[
        options.port_argument(),
        *search_options(),
        Option(
            ["--bauds"],
            type=options.ParsedType("bauds", parse_bauds, "cli.expect.bauds"),
            metavar="B,...",
            example="--bauds 9600,19200",
        ),
        Option(
            ["--formats"],
            type=options.ParsedType("formats", parse_formats, "cli.expect.formats"),
            metavar="F,...",
            example="--formats 8N1,8E1",
        ),
        options.encoding_option(),
        listen_option(),
        Option(["--anyway"], is_flag=True),
        Option(["--all", "everything"], is_flag=True, key="help.option.all"),
        options.record_option(),
        options.dry_run_option(),
    ],
    examples=(
        "drivebus scan /dev/ttyUSB0",
        "drivebus scan /dev/ttyUSB0 --models c320 --addresses 1-8 --bauds 9600 --formats 8E1,8N1",
        "drivebus scan sim://vc660@3 --models vc660 --addresses 1-5 --json",
        "drivebus scan tcp://192.168.1.50:4001 --dry-run",
        "drivebus scan /dev/ttyUSB0 --record what-answered.dbcap",
    ),
)
