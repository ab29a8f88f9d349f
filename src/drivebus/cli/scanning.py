"""Scan of a port for the commands ``scan``, ``init`` and ``monitor``: options, plan, search, selection."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import click

from drivebus.cli import options, output
from drivebus.cli.click_ext import Option
from drivebus.cli.connect import reject_own_terminal
from drivebus.cli.scan_output import ScanProgressBar, announce_scan, note_unsent

if TYPE_CHECKING:
    from drivebus.commissioning.scan import DetectedDrive, ScanProgress, SniffResult
    from drivebus.commissioning.scan_plan import ScanPass
    from drivebus.ports import Port
    from drivebus.serial_settings import SerialSettings

# --- options ------------------------------------------------------------------------------------------------------


def parse_words(text: str) -> tuple[str, ...]:
    """Parse ``a,b``. Raises ValueError for an empty field: a value may be missing there."""
    words = tuple(part.strip() for part in text.split(","))
    if not all(words):
        raise ValueError(text)
    return words


def parse_models(text: str) -> tuple[str, ...]:
    """Parse ``c320,vc660``. Raises ValueError."""
    return tuple(map(options.parse_model, parse_words(text)))


def parse_bauds(text: str) -> tuple[int, ...]:
    """Parse ``9600,19200``. Raises ValueError."""
    words = parse_words(text)
    if not all(options.WHOLE_NUMBER.fullmatch(word) and 50 <= int(word) <= 4_000_000 for word in words):
        raise ValueError(text)
    return tuple(map(int, words))


def parse_formats(text: str) -> tuple[str, ...]:
    """Parse ``8N1,8E1``. Raises ValueError."""
    from drivebus.serial_settings import SerialSettings

    return tuple(SerialSettings.parse(9600, part).format for part in parse_words(text))


def search_options() -> list[click.Parameter]:
    """Return ``--models``, ``--addresses``, ``--bauds`` and ``--formats``: what a scan looks for."""
    models = options.ParsedType("models", parse_models, "cli.expect.models")
    return [
        Option(
            ["--models"],
            type=models,
            metavar="M,...",
            shell_complete=options.complete_model_list,
            example="--models c320,vc660",
        ),
        Option(["--addresses"], type=options.ADDRESSES, metavar="N,...", example="--addresses 1-8"),
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
    ]


def listen_option() -> click.Option:
    """Return ``--listen-seconds``: time to listen for another master before the first request."""
    seconds = options.NumberType(0.0, 86_400.0)
    return Option(["--listen-seconds"], type=seconds, default=2.0, metavar="S", example="--listen-seconds 5")


# --- plan and search ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class ScanRequest:
    """Port and range of a scan; None stands for every value that the models have, and for every included model."""

    port: str
    models: tuple[str, ...] | None = None
    addresses: tuple[int, ...] | None = None
    bauds: tuple[int, ...] | None = None
    formats: tuple[str, ...] | None = None
    encoding: str | None = None

    def plan(self) -> list[ScanPass]:
        """Return the passes. ``?baud=`` and ``&format=`` of the URL, and a raw TCP server, fix the settings."""
        from drivebus import ports, profiles
        from drivebus.commissioning.scan_plan import (
            FIXED_SETTINGS_SCHEMES,
            default_models,
            plan_scan,
            with_look_alikes,
        )

        named = None if self.models is None else with_look_alikes([profiles.load(model) for model in self.models])
        models, others = default_models() if named is None else (named, [])
        parsed = ports.parse_port_url(self.port)
        fixed = ports.open_port(self.port).settings if parsed.scheme in FIXED_SETTINGS_SCHEMES else None
        return plan_scan(
            models,
            others=others,
            addresses=self.addresses,
            bauds=self.bauds or ((parsed.settings.baud,) if "baud" in parsed.explicit else None),
            formats=self.formats or ((parsed.settings.format,) if "format" in parsed.explicit else None),
            encodings=(self.encoding,) if self.encoding else None,
            fixed=fixed,
        )

    def open_port(self, settings: SerialSettings) -> Port:
        """Return the port with these serial settings, not yet opened. Raises PortUnavailable for the own terminal."""
        from drivebus import ports

        reject_own_terminal(self.port)
        return ports.open_port(self.port, baud=settings.baud, format=settings.format)


async def listen_for_master(port: Port, seconds: float) -> SniffResult:
    """Listen before the first request, and print whether another master is active. Raises PortUnavailable."""
    from drivebus.commissioning import scan

    sniffed = await scan.sniff(port, seconds, lambda: output.print_note("scan.listening", seconds=f"{seconds:g}"))
    if sniffed.count:
        output.print_note("scan.foreign", count=sniffed.count, seconds=f"{sniffed.seconds:g}")
    return sniffed


async def search(
    request: ScanRequest, listen_s: float, progress: ScanProgress | None = None
) -> list[DetectedDrive] | None:
    """Listen, then scan; return the drives that a model fits, or None if another master is active.

    ``progress`` has what was found so far, also where the scan is cancelled or fails. Raises PortUnavailable, PortLost.
    """
    from drivebus.commissioning import scan

    passes = request.plan()
    if listen_s > 0 and passes and (await listen_for_master(request.open_port(passes[0].settings), listen_s)).count:
        return None
    announce_scan(passes)
    progress = progress or scan.ScanProgress(total_s=0.0)
    progress.total_s = sum(scan_pass.duration_s for scan_pass in passes)
    with ScanProgressBar() as bar:
        await scan.scan(passes, request.open_port, progress, bar.on_progress)
    note_unsent(progress)
    return fitting_drives(progress)


def fitting_drives(progress: ScanProgress) -> list[DetectedDrive]:
    """Return the drives found so far that a model fits."""
    return [drive for drive in progress.found if drive.models]


def select_alike(detected: list[DetectedDrive], left_out: Callable[[DetectedDrive], None]) -> list[DetectedDrive]:
    """Select one drive per address with the settings, family and encoding of the first; report each other address.

    A C320 answers in two encodings: the one found first is taken.
    """
    if not detected:
        return []

    def kind(drive: DetectedDrive) -> tuple[object, ...]:
        return (drive.settings, drive.family, drive.encoding)

    alike = {drive.address: drive for drive in detected if kind(drive) == kind(detected[0])}
    for drive in detected:
        if drive.address not in alike:
            left_out(drive)
    return [alike[address] for address in sorted(alike)]
