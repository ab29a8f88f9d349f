"""Scan of a port for the commands ``scan``, ``init`` and ``monitor``: plan, search, selection, output."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from math import ceil
from typing import TYPE_CHECKING, Any

import click

from drivebus.cli import options, output
from drivebus.cli.click_ext import Option
from drivebus.cli.errors import ExitCode, error_hint, error_json, error_text, print_error
from drivebus.cli.output import ProgressBar, format_duration
from drivebus.types import Json
from drivebus.values import format_addresses

if TYPE_CHECKING:
    from drivebus.commissioning.scan import DetectedDrive, ScanProgress, SniffResult
    from drivebus.commissioning.scan_plan import ScanPass
    from drivebus.errors import DrivebusError
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
        """Return the port with these serial settings, not yet opened."""
        from drivebus import ports

        return ports.open_port(self.port, baud=settings.baud, format=settings.format)


async def search(
    request: ScanRequest, listen_s: float, progress: ScanProgress | None = None
) -> list[DetectedDrive] | None:
    """Listen, then scan; return the drives that a model fits, or None if another master is active.

    ``progress`` has what was found so far, also where the scan is cancelled or fails. Raises PortUnavailable, PortLost.
    """
    from drivebus.commissioning import scan

    passes = request.plan()
    if listen_s > 0 and passes:
        port = request.open_port(passes[0].settings)
        output.print_note("scan.listening", seconds=f"{listen_s:g}")
        sniffed = await scan.sniff(port, listen_s)
        if sniffed.count:
            output.print_note("scan.foreign", count=sniffed.count, seconds=f"{sniffed.seconds:g}")
            return None
    announce_scan(passes)
    progress = progress or scan.ScanProgress(total_s=0.0)
    progress.total_s = sum(scan_pass.duration_s for scan_pass in passes)
    with ScanProgressBar() as bar:
        await scan.scan(passes, request.open_port, progress, bar.on_progress)
    _note_unsent(progress)
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


def assumed_models_texts(drives: list[DetectedDrive]) -> list[str]:
    """Return a sentence on the drives of each list of models that the bus can't tell; the first model is taken."""
    addresses: dict[tuple[tuple[str, ...], bool], list[str]] = {}
    for drive in drives:
        if drive.doubtful:
            addresses.setdefault((drive.models, drive.fits_partly), []).append(str(drive.address))
    return [
        _assumed_text(output.join(alike, "items"), models, fits_partly=fits_partly)
        for (models, fits_partly), alike in addresses.items()
    ]


def _assumed_text(addresses: str, models: tuple[str, ...], *, fits_partly: bool) -> str:
    if fits_partly:
        return output.text("scan.assumed_partly", address=addresses, models="/".join(models))
    return output.text("scan.assumed", address=addresses, model=models[0], others=output.join(models[1:], "items"))


def note_drives(drives: list[DetectedDrive]) -> None:
    """Print the table of a scan on standard error; nothing without a drive."""
    if drives:
        output.echo(_scan_table(drives, sys.stderr), err=True)


# --- output -------------------------------------------------------------------------------------------------------


class ScanProgressBar(ProgressBar):
    """Progress bar of a scan; it prints each drive at once."""

    def __init__(self) -> None:
        super().__init__()
        self._reported = 0

    def __enter__(self) -> ScanProgressBar:
        super().__enter__()
        return self

    def on_progress(self, progress: ScanProgress) -> None:
        """Show the progress."""
        for drive in progress.found[self._reported :]:
            if not drive.unreadable:
                self.print_above(output.text("scan.found", **_device_params(drive)))
        self._reported = len(progress.found)
        if progress.address is not None:
            where = f"{progress.settings} {progress.kind[0]}/{progress.kind[1]} {progress.address:3d}"
            self.update(where, progress.done_s, progress.total_s)


def _device_params(drive: DetectedDrive) -> dict[str, Any]:
    return {
        "models": "/".join(drive.models) or output.text("scan.unknown"),
        "address": drive.address,
        "settings": str(drive.settings),
        "encoding": drive.encoding,
    }


def print_scan(
    port: str,
    progress: ScanProgress,
    sniffed: SniffResult | None,
    code: ExitCode,
    error: DrivebusError | None = None,
) -> ExitCode:
    """Print the result of a scan, and the error that ended it; return ``code``."""
    foreign = None
    if sniffed is not None:
        foreign = {
            "bytes": sniffed.count,
            "line_errors": sniffed.line_errors,
            "first": sniffed.first,
            "seconds": sniffed.seconds,
        }
    output.print_json(
        {
            "port": port,
            "foreign_traffic": foreign,
            "found": [device_json(drive) for drive in progress.found],
            "complete": code in (ExitCode.DONE, ExitCode.FAILED) and progress.left_s < 1e-6 and not progress.unsent,
            "unsent": progress.unsent,
            "scanned_s": round(progress.done_s, 3),
            **({} if error is None else error_json(error) | {"exit": int(code)}),
        }
    )
    if progress.found or progress.done_s > 0:
        output.print_text(_scan_table(progress.found))
    named = (drive.unusable_reply for drive in progress.found if drive.unreadable)  # no other row of the table names it
    for hint in dict.fromkeys(filter(None, (error_hint(error) for error in named if error is not None))):
        output.print_wrapped(hint)
    _note_unsent(progress)
    if error is not None:
        print_error(error)
    return code


def _note_unsent(progress: ScanProgress) -> None:
    if progress.unsent:
        output.print_note("scan.unsent", count=progress.unsent)


def device_json(drive: DetectedDrive) -> Json:
    """Return a detected drive as JSON."""
    return {
        "models": list(drive.models),
        "family": drive.family,
        "encoding": drive.encoding,
        "address": drive.address,
        "baud": drive.settings.baud,
        "format": drive.settings.format,
        "doubtful": drive.doubtful,
        "valid_reply": drive.valid_reply,
        "replied_address": drive.replied_address,
        "replied_late": drive.replied_late,
        "fits_partly": drive.fits_partly,
        "unusable_reply": None if drive.unusable_reply is None else error_text(drive.unusable_reply),
        "setpoint_steps_hz": dict(drive.setpoint_steps_hz),
        "sent": drive.exchange[0],
        "received": drive.exchange[1],
    }


def _note(drive: DetectedDrive) -> str:
    """Return why the model is in doubt; empty where it is not."""
    if drive.replied_address is not None:
        key = "scan.late_reply" if drive.replied_late else "scan.other_address"
        return output.text(key, found=drive.replied_address, address=drive.address)
    if not drive.models:
        return output.text("scan.rejected", family=drive.family)
    if drive.fits_partly:
        return output.text("scan.partly")
    if not drive.doubtful:
        return ""
    models_by_step: dict[float | None, list[str]] = {}
    for model, step in drive.setpoint_steps_hz.items():
        models_by_step.setdefault(step, []).append(model)
    unknown = [model for model in drive.models if model not in drive.setpoint_steps_hz]
    if len(models_by_step) + bool(unknown) <= 1:
        return output.text("scan.alike")
    steps = [
        output.text("scan.share", models=output.join(names, "items"))
        if hz is None
        else output.text("scan.step", models=output.join(names, "items"), step=f"{hz:g}")
        for hz, names in models_by_step.items()
    ]
    if unknown:
        steps.append(output.text("scan.step_unknown", models=output.join(unknown, "items")))
    return output.text("scan.alike_steps", steps=output.join(steps, "clauses"))


def _scan_table(detected: list[DetectedDrive], stream: Any = None) -> str:
    if not detected:
        return output.wrap_for(output.text("scan.nothing"), stream or sys.stdout)
    head = [output.text(f"scan.{name}") for name in ("address", "model", "encoding", "serial", "note")]
    readable = _readable_rows([drive for drive in detected if not drive.unreadable])
    unreadable = _unreadable_rows([drive for drive in detected if drive.unreadable])
    return output.fitted_table(head, readable + unreadable, stream)


def _readable_rows(detected: list[DetectedDrive]) -> list[list[str]]:
    """Return the rows of addresses that sent valid frames: one for all encodings and settings that were answered alike.

    One drive answers in several settings where the port does not compare the parity, as a pty does not.
    """
    encodings: dict[tuple[int, tuple[str, ...], str, SerialSettings], list[str]] = {}
    for drive in detected:
        encodings.setdefault((drive.address, drive.models, _note(drive), drive.settings), []).append(drive.encoding)
    settings: dict[tuple[int, tuple[str, ...], str, tuple[str, ...]], list[SerialSettings]] = {}
    for (address, models, note, one), names in encodings.items():
        settings.setdefault((address, models, note, tuple(names)), []).append(one)
    return [
        [
            str(address),
            " / ".join(models) or output.text("scan.unknown"),
            output.join(names, "items"),
            output.join(_formats_by_baud(alike), "items"),
            note,
        ]
        for (address, models, note, names), alike in settings.items()
    ]


def _unreadable_rows(detected: list[DetectedDrive]) -> list[list[str]]:
    """Return the rows of addresses that sent bytes without a valid reply: one for all that were tried alike.

    An address that sent whole replies has only the settings with which they were received.
    """
    tried: dict[int, list[DetectedDrive]] = {}
    for drive in detected:
        tried.setdefault(drive.address, []).append(drive)
    addresses: dict[tuple[str, str, str], list[int]] = {}
    for address, drives in sorted(tried.items()):
        named = [drive for drive in drives if drive.unusable_reply is not None]
        encodings = output.join(dict.fromkeys(drive.encoding for drive in named or drives), "items")
        settings = output.join(_formats_by_baud(drive.settings for drive in named or drives), "items")
        errors = [error_text(drive.unusable_reply) for drive in named if drive.unusable_reply is not None]
        note = errors[0] if errors else output.text("scan.no_valid_reply")
        addresses.setdefault((encodings, settings, note), []).append(address)
    return [
        [format_addresses(alike), output.text("scan.unknown"), encodings, settings, note]
        for (encodings, settings, note), alike in addresses.items()
    ]


def _formats_by_baud(settings: Iterable[SerialSettings]) -> list[str]:
    """Return ``9600 8N1/8E1`` for each baud rate."""
    formats: dict[int, dict[str, None]] = {}
    for one in settings:
        formats.setdefault(one.baud, {})[one.format] = None
    return [f"{baud} {'/'.join(names)}" for baud, names in formats.items()]


def duration_params(passes: list[ScanPass]) -> dict[str, str]:
    """Return the announced durations: of the likely settings and addresses, of all, and of a device that answers."""
    from drivebus.commissioning.scan import NOISE_ALLOWANCE_S
    from drivebus.commissioning.scan_plan import device_duration_s, durations_s

    likely, total = durations_s(passes)
    usual = [each for each in passes if each.is_likely and each.has_factory_settings]
    device = max(map(device_duration_s, usual or passes[:1]), default=0.0)
    return {
        "likely": format_duration(likely),
        "time": format_duration(total),
        "device_s": f"{ceil(device)}",
        "noise_s": f"{NOISE_ALLOWANCE_S:g}",
    }


def announce_scan(passes: list[ScanPass]) -> None:
    """Print how long the scan takes, with its likely settings where it has others too."""
    likely = [each for each in passes if each.is_likely]
    if not likely or len(likely) == len(passes):
        output.print_note("scan.comm_loss", **duration_params(passes))
        return
    bauds = output.join([str(baud) for baud in dict.fromkeys(each.settings.baud for each in likely)], "items")
    addresses = format_addresses(sorted({address for each in likely for address in each.addresses}))
    output.print_note("scan.comm_loss_likely", bauds=bauds, addresses=addresses, **duration_params(passes))


def print_scan_plan(passes: list[ScanPass]) -> ExitCode:
    """Print the first request of each pass, byte for byte, and the number of requests."""
    from drivebus.cli.dry_run import plan_frames
    from drivebus.commissioning.scan_plan import durations_s, probe_request
    from drivebus.drives.dialects.create import create_dialect

    documents = []
    for scan_pass in passes:
        candidate = scan_pass.candidates[0]
        dialect = create_dialect(candidate.profile, scan_pass.addresses[0], encoding=candidate.encoding)
        station = dialect.station_config
        frame = plan_frames("scan", [probe_request(dialect)], station.codec, station.timing, scan_pass.settings)[0]
        where = {"serial": str(scan_pass.settings), "family": candidate.profile.family, "encoding": candidate.encoding}
        effort = {"requests": scan_pass.probe_count, "seconds": round(scan_pass.duration_s, 3)}
        documents.append(where | {"likely": scan_pass.is_likely} | effort | frame.to_json())
        data, time = output.to_json_value(frame.data), format_duration(scan_pass.duration_s)
        output.print_message("scan.pass", hex=data, time=time, count=scan_pass.probe_count, **where)
    likely, total = durations_s(passes)
    output.print_json(
        {"dry_run": True, "passes": documents, "likely_seconds": round(likely, 3), "seconds": round(total, 3)}
    )
    output.print_message("scan.total", **duration_params(passes))
    return ExitCode.DONE
