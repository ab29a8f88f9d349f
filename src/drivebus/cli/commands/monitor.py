"""``monitor``: the live view of a real line, of a capture, or of a service's plant. Reads only."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from drivebus.cli import options, output
from drivebus.cli.click_ext import Option
from drivebus.cli.errors import ExitCode
from drivebus.cli.remote import options as remote_options
from drivebus.cli.remote.options import RemoteCommand
from drivebus.errors import ConfigurationError

if TYPE_CHECKING:
    from drivebus.cli.tui.row_source import RowSource
    from drivebus.commissioning.scan import DetectedDrive, ScanPass
    from drivebus.profiles import DriveProfile
    from drivebus.serial_settings import SerialSettings

Known = list[tuple["DriveProfile", str | None, int]]


@dataclass(frozen=True, slots=True)
class MonitorOptions:
    """The verb's options."""

    source: str
    model: str | None
    addresses: tuple[int, ...] | None
    baud: int | None
    format: str | None
    encoding: str | None
    plain: bool
    period: float
    duration: float | None
    speed: float
    record: str | None

    @property
    def of_capture(self) -> bool:
        return self.source.endswith(".dbcap")

    @property
    def models(self) -> tuple[str, ...]:
        from drivebus.protocols.family import default_scan_models

        return (self.model,) if self.model else default_scan_models()

    def passes(self) -> list[ScanPass]:
        """The scan that finds out who is there, where the options do not say it."""
        from drivebus.cli.commands.scan import make_plan

        bauds, formats = (self.baud,) if self.baud else None, (self.format,) if self.format else None
        return make_plan(self.source, self.models, self.addresses, bauds, formats, self.encoding)

    def show(self, feed: RowSource) -> ExitCode:
        from drivebus.cli.tui.view import run_view

        return run_view(feed, None, self.plain, self.period, self.duration)


def _monitor(dry_run: bool, service: str | None, **given: Any) -> ExitCode:
    if service is not None:
        return _service(service, {**given, "address": given["addresses"], "dry_run": dry_run})
    asked = MonitorOptions(**given)
    if asked.record and asked.of_capture:
        raise ConfigurationError("record.of_capture", file=asked.source)
    if dry_run:
        return _plan(asked)
    return _capture(asked) if asked.of_capture else _line(asked)


def _service(service: str, given: dict[str, Any]) -> ExitCode:
    """Its whole plant; what is about a line of one's own is refused."""
    from drivebus.cli.tui.service_source import ServiceRowSource
    from drivebus.cli.tui.view import run_view

    remote_options.reject_local_options(given, ("model", "address", "baud", "format", "encoding", "record"))
    return run_view(ServiceRowSource(service), None, given["plain"], given["period"], given["duration"])


def _capture(asked: MonitorOptions) -> ExitCode:
    from drivebus import profiles
    from drivebus.capture.dbcap import read_capture
    from drivebus.cli.tui.capture_source import CaptureRowSource

    file, speed = asked.source, asked.speed
    capture = read_capture(file)
    chosen = [profiles.load(name) for name in asked.models]
    candidates = [(one, each) for one in chosen for each in one.encodings if asked.encoding in (None, each)]
    title = output.text("monitor.title_file", file=file, line=capture.header.settings, speed=f"{speed:g}")
    return asked.show(CaptureRowSource(capture, candidates, title, speed))


def _line(asked: MonitorOptions) -> ExitCode:
    from drivebus import profiles
    from drivebus.cli.connect import open_port, record_port
    from drivebus.cli.tui.bus_source import BusRowSource

    known: Known
    baud, format = asked.baud, asked.format
    if asked.model is not None and asked.addresses is not None:
        profile = profiles.load(asked.model)
        known = [(profile, asked.encoding, address) for address in asked.addresses]
    else:
        known, baud, format = asyncio.run(_scanned(asked))
        if not known:
            output.print_message("scan.nobody")
            return ExitCode.FAILED
    port = open_port(asked.source, known[0][0], baud, format)
    title = output.text("monitor.title", link=asked.source, line=port.settings, count=len(known))
    with record_port(port, asked.record) as heard:
        return asked.show(BusRowSource(heard, known, title))


def _plan(asked: MonitorOptions) -> ExitCode:
    """One round of polls; without --model and --address the scan that would come first. A capture sends nothing."""
    from drivebus.cli import dry_run as dry
    from drivebus.cli.connect import Target
    from drivebus.cli.scanning import print_scan_plan as show_scan
    from drivebus.cli.tui.rows import COLUMN_SIGNALS

    if asked.of_capture:
        return dry.print_plan([], _line_of(asked.source))
    if asked.model is None or asked.addresses is None:
        return show_scan(asked.passes())
    planned: list[dry.PlannedFrame] = []
    for address in asked.addresses:
        one = dry.DryRun(Target(asked.source, asked.model, address, asked.baud, asked.format, asked.encoding))
        names = tuple(name for name in COLUMN_SIGNALS if name in one.dialect.profile.signals)
        one.add("signals", [request for request, _ in one.dialect.polls(names)])
        planned += one.frames
    return dry.print_plan(planned, one.serial_settings, ["dry.note.rounds"])


def _line_of(file: str) -> SerialSettings:
    from drivebus.capture.dbcap import read_capture

    return read_capture(file).header.settings


async def _scanned(asked: MonitorOptions) -> tuple[Known, int | None, str | None]:
    """Find out who is there; reads only, after listening. Another master ends it: nothing is found."""
    from drivebus import ports, profiles
    from drivebus.cli.scanning import ScanProgressBar
    from drivebus.commissioning import scan

    def open_port(settings: SerialSettings) -> ports.Port:
        return ports.open_port(asked.source, baud=settings.baud, format=settings.format)

    passes = asked.passes()
    output.print_note("scan.listening", seconds=2)
    overheard = await scan.sniff(open_port(passes[0].settings), 2.0)
    if overheard.count:
        output.print_note("scan.foreign", count=overheard.count, seconds=2)
        return [], None, None
    progress = scan.ScanProgress(sum(one.duration_s for one in passes))
    with ScanProgressBar() as meter:
        await scan.scan(passes, open_port, progress, meter.on_progress)
    found = [one for one in progress.found if not one.doubtful]
    if not found:
        return [], None, None
    # A C320 answers in two encodings: the first that it was found with counts.
    alike = {one.address: one for one in found if _kind(one) == _kind(found[0])}
    for one in found:
        if one.address not in alike:
            output.print_note("monitor.left_out", address=one.address, models="/".join(one.models))
    known: Known = [
        (profiles.load(asked.model or one.models[0]), one.encoding, address) for address, one in sorted(alike.items())
    ]
    return known, found[0].settings.baud, found[0].settings.format


def _kind(one: DetectedDrive) -> tuple[object, ...]:
    return (one.settings, one.family, one.encoding)


command = RemoteCommand(
    "monitor",
    callback=_monitor,
    params=[
        options.source_argument(),
        options.model_option(required=False),
        Option(
            ["--address", "addresses"],
            type=options.ADDRESSES,
            metavar="N,...",
            key="help.option.addresses",
            example="--address 1-3,7",
        ),
        *options.serial_options(),
        options.encoding_option(),
        Option(["--plain"], is_flag=True),
        Option(["--period"], type=options.PERIOD, default=5.0, metavar="S", example="--period 2"),
        Option(["--duration"], type=options.NumberType(0.01, 604_800.0), metavar="S", example="--duration 60"),
        options.record_option(),
        *remote_options.service_option(),
        options.dry_run_option(),
        Option(
            ["--speed"],
            type=options.NumberType(0.01, 1000.0),
            default=1.0,
            metavar="X",
            key="help.option.fast",
            example="--speed 10",
        ),
    ],
    examples=(
        "drivebus monitor /dev/ttyUSB0 --model c320 --address 1-3",
        "drivebus monitor /dev/ttyUSB0",
        "drivebus monitor /dev/ttyUSB0 --model c320 --address 1-3 --record trip-of-pump-3.dbcap",
        "drivebus monitor trip-of-pump-3.dbcap --speed 10",
        "drivebus monitor sim://vc660@1-4 --model vc660 --address 1-4 --json --duration 10",
        "drivebus monitor --service http://127.0.0.1:8080",
    ),
)
