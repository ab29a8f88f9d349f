"""``monitor``: live view of a bus, of a capture, or of a running service. Sends only reads."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from drivebus.cli import options, output
from drivebus.cli.click_ext import Option
from drivebus.cli.drive_command import RemoteCommand, reject_local_options
from drivebus.cli.errors import ExitCode
from drivebus.cli.scan_output import assumed_models_texts, note_drives, print_scan_plan
from drivebus.cli.scanning import ScanRequest, fitting_drives, search, select_alike
from drivebus.errors import ConfigurationError

if TYPE_CHECKING:
    from drivebus.cli.tui.row_source import RowSource
    from drivebus.commissioning.scan import DetectedDrive
    from drivebus.profiles import DriveProfile

LISTEN_S = 2.0  # time to listen for another master before the scan

Stations = list[tuple["DriveProfile", str | None, int]]
"""Profile, encoding and address of each drive."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MonitorOptions:
    """Options of the command."""

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
    def is_capture(self) -> bool:
        return self.source.endswith(".dbcap")

    def scan_request(self) -> ScanRequest:
        """Return the scan that finds the drives that the options do not name."""
        return ScanRequest(
            port=self.source,
            models=(self.model,) if self.model else None,
            addresses=self.addresses,
            bauds=(self.baud,) if self.baud else None,
            formats=(self.format,) if self.format else None,
            encoding=self.encoding,
        )

    def run_view(self, source: RowSource) -> ExitCode:
        from drivebus.cli.tui.view import run_view

        return run_view(source, None, plain=self.plain, period_s=self.period, duration_s=self.duration)


def _monitor(*, dry_run: bool, service: str | None, **arguments: Any) -> ExitCode:
    if service is not None:
        return _monitor_service(service, {**arguments, "address": arguments["addresses"], "dry_run": dry_run})
    chosen = MonitorOptions(**arguments)
    if chosen.record and chosen.is_capture:
        raise ConfigurationError("record.of_capture", file=chosen.source)
    if dry_run:
        return _print_plan(chosen)
    return _play_capture(chosen) if chosen.is_capture else _monitor_bus(chosen)


def _monitor_service(service: str, options: dict[str, Any]) -> ExitCode:
    from drivebus.cli.tui.service_source import ServiceRowSource
    from drivebus.cli.tui.view import run_view

    reject_local_options(options, ("model", "address", "baud", "format", "encoding", "record"))
    return run_view(
        ServiceRowSource(service),
        None,
        plain=options["plain"],
        period_s=options["period"],
        duration_s=options["duration"],
    )


def _play_capture(chosen: MonitorOptions) -> ExitCode:
    from drivebus import profiles
    from drivebus.capture.dbcap import read_capture
    from drivebus.cli.tui.capture_source import CaptureRowSource
    from drivebus.protocols.family import common_scan_models

    capture = read_capture(chosen.source)
    models = [profiles.load(name) for name in ((chosen.model,) if chosen.model else common_scan_models())]
    candidates = [(model, each) for model in models for each in model.encodings if chosen.encoding in (None, each)]
    title = output.text(
        "monitor.title_file", file=chosen.source, serial=capture.header.settings, speed=f"{chosen.speed:g}"
    )
    return chosen.run_view(CaptureRowSource(capture, candidates, title, chosen.speed))


def _monitor_bus(chosen: MonitorOptions) -> ExitCode:
    from drivebus import profiles
    from drivebus.cli.connect import open_port, record_port
    from drivebus.cli.tui.bus_source import BusRowSource

    stations: Stations
    baud, format = chosen.baud, chosen.format
    notes: list[str] = []
    assumed: list[int] = []
    if chosen.model is not None and chosen.addresses is not None:
        profile = profiles.load(chosen.model)
        stations = [(profile, chosen.encoding, address) for address in chosen.addresses]
    else:
        detected, code = asyncio.run(_find_drives(chosen.scan_request()))
        if code is not ExitCode.DONE:
            return code
        alike = select_alike(detected, _report_left_out)
        if chosen.model is None:
            note_drives([drive for drive in alike if drive.doubtful])
            assumed = [drive.address for drive in alike if drive.doubtful]
            notes = [*assumed_models_texts(alike), output.text("monitor.assumed")] if assumed else []
        stations = [(profiles.load(chosen.model or drive.models[0]), drive.encoding, drive.address) for drive in alike]
        baud, format = detected[0].settings.baud, detected[0].settings.format
    port = open_port(chosen.source, stations[0][0], baud, format)
    title = output.text("monitor.title", port=chosen.source, serial=port.settings, count=len(stations))
    with record_port(port, chosen.record) as recorded:
        return chosen.run_view(BusRowSource(recorded, stations, title, notes, assumed))


async def _find_drives(request: ScanRequest) -> tuple[list[DetectedDrive], ExitCode]:
    """Scan the port; return its drives, and DONE if it has any. Prints what was found before an interruption."""
    from drivebus.cli.signals import shutdown_signals
    from drivebus.commissioning.scan import ScanProgress

    output.print_note("monitor.search")
    progress = ScanProgress(total_s=0.0)
    with shutdown_signals() as shutdown:
        detected = await shutdown.interruptible(search(request, LISTEN_S, progress))
    if shutdown.received:
        output.print_note("scan.aborted")
        note_drives(fitting_drives(progress))
        return [], ExitCode.INTERRUPTED
    if detected == []:  # None: nothing was sent, and the reason is printed
        output.print_message("scan.nothing")
    return detected or [], ExitCode.DONE if detected else ExitCode.FAILED


def _report_left_out(drive: DetectedDrive) -> None:
    output.print_note("monitor.left_out", address=drive.address, models="/".join(drive.models))


def _print_plan(chosen: MonitorOptions) -> ExitCode:
    """Print one round of polls, or the scan before it; nothing for a capture."""
    from drivebus.cli.connect import Target
    from drivebus.cli.dry_run import DryRun, PlannedFrame, print_plan
    from drivebus.cli.tui.rows import COLUMN_SIGNALS

    if chosen.is_capture:
        from drivebus.capture.dbcap import read_capture

        return print_plan([], read_capture(chosen.source).header.settings)
    if chosen.model is None or chosen.addresses is None:
        return print_scan_plan(chosen.scan_request().plan())
    frames: list[PlannedFrame] = []
    for address in chosen.addresses:
        target = Target(
            port=chosen.source,
            model=chosen.model,
            address=address,
            baud=chosen.baud,
            format=chosen.format,
            encoding=chosen.encoding,
        )
        dry = DryRun(target)
        names = tuple(name for name in COLUMN_SIGNALS if name in dry.dialect.profile.signals)
        dry.add("signals", [request for request, _ in dry.dialect.polls(names)])
        frames += dry.frames
    return print_plan(frames, dry.serial_settings, [("dry.note.rounds", {})])


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
        options.service_option(),
        options.dry_run_option(),
        Option(
            ["--speed"],
            type=options.NumberType(0.01, 1000.0),
            default=1.0,
            metavar="X",
            key="help.option.speed",
            example="--speed 10",
        ),
    ],
    examples=(
        "drivebus monitor /dev/ttyUSB0 --model c320 --address 1-3",
        "drivebus monitor /dev/ttyUSB0",
        "drivebus monitor /dev/ttyUSB0 --model c320 --address 1-3 --record trip.dbcap",
        "drivebus monitor trip.dbcap --speed 10",
        "drivebus monitor sim://c320@1 --model c320 --address 1 --json --duration 10",
        "drivebus monitor --service http://127.0.0.1:8080",
    ),
)
