"""Output of a scan: announced durations, progress, tables, JSON, and the plan of a dry run."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from math import ceil
from typing import TYPE_CHECKING, Any

from drivebus.cli import output
from drivebus.cli.errors import ExitCode, error_hint, error_json, error_text, print_error
from drivebus.cli.output import ProgressBar, format_duration
from drivebus.types import Json
from drivebus.user_input import format_addresses

if TYPE_CHECKING:
    from drivebus.commissioning.scan import DetectedDrive, ScanProgress, SniffResult
    from drivebus.commissioning.scan_plan import ScanPass
    from drivebus.errors import DrivebusError
    from drivebus.serial_settings import SerialSettings


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
        "models": " / ".join(drive.models) or output.text("scan.unknown"),
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
    named = (drive.unusable_reply for drive in progress.found if drive.unreadable or drive.fits_partly)
    for hint in dict.fromkeys(filter(None, (error_hint(error) for error in named if error is not None))):
        output.print_wrapped(hint)
    note_unsent(progress)
    if error is not None:
        print_error(error)
    return code


def note_unsent(progress: ScanProgress) -> None:
    """Print how many requests could not be sent, where there were any."""
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
        return error_text(drive.unusable_reply) if drive.unusable_reply is not None else output.text("scan.partly")
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
    for (address, models, note, serial), names in encodings.items():
        settings.setdefault((address, models, note, tuple(names)), []).append(serial)
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
    for serial in settings:
        formats.setdefault(serial.baud, {})[serial.format] = None
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


def note_drives(drives: list[DetectedDrive]) -> None:
    """Print the table of a scan on standard error; nothing without a drive."""
    if drives:
        output.echo(_scan_table(drives, sys.stderr), err=True)


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
