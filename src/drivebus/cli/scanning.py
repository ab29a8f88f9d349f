"""A scan for people and programs: the bar while it runs, what it found, and what it would ask."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from drivebus.cli import output
from drivebus.cli.errors import ExitCode
from drivebus.cli.progress import ProgressBar, format_duration

if TYPE_CHECKING:
    from drivebus.commissioning.scan import DetectedDrive, ScanPass, ScanProgress, SniffResult


class ScanProgressBar(ProgressBar):
    """The bar of a scan; what is found is told above it at once."""

    def __init__(self) -> None:
        super().__init__()
        self._reported = 0

    def __enter__(self) -> ScanProgressBar:
        super().__enter__()
        return self

    def on_progress(self, progress: ScanProgress) -> None:
        """The scan moved on."""
        for found in progress.found[self._reported :]:
            self.print_above(output.text("scan.found", **_device_params(found)))
        self._reported = len(progress.found)
        if progress.address is not None:
            where = f"{progress.settings} {progress.kind[0]}/{progress.kind[1]} {progress.address:3d}"
            self.update(where, progress.done_s, progress.total_s)


def _device_params(found: DetectedDrive) -> dict[str, Any]:
    return {
        "models": "/".join(found.models),
        "address": found.address,
        "settings": str(found.settings),
        "encoding": found.encoding,
    }


def print_scan(link: str, progress: ScanProgress, overheard: SniffResult | None, code: ExitCode) -> ExitCode:
    output.print_json(
        {
            "link": link,
            "overheard": None
            if overheard is None
            else {
                "bytes": overheard.count,
                "line_errors": overheard.line_errors,
                "first": overheard.first,
                "seconds": overheard.seconds,
            },
            "found": [device_json(found) for found in progress.found],
            "complete": code in (ExitCode.DONE, ExitCode.FAILED) and progress.left_s < 1e-6,
            "asked_s": round(progress.done_s, 3),
        }
    )
    if progress.found or progress.done_s > 0:
        output.print_text(_scan_table(progress.found))
    return code


def device_json(found: DetectedDrive) -> dict[str, Any]:
    """One find as JSON."""
    return {
        "models": list(found.models),
        "family": found.family,
        "encoding": found.encoding,
        "address": found.address,
        "baud": found.settings.baud,
        "format": found.settings.format,
        "doubtful": found.doubtful,
        "sent": found.exchange[0],
        "received": found.exchange[1],
    }


def _scan_table(found: list[DetectedDrive]) -> str:
    if not found:
        return output.text("scan.nobody")
    head = [output.text(f"scan.{name}") for name in ("address", "model", "encoding", "line", "note")]
    rows = [
        [
            str(one.address),
            " / ".join(one.models),
            one.encoding,
            str(one.settings),
            output.text("scan.doubtful") if one.doubtful else "",
        ]
        for one in found
    ]
    return output.fitted_table(head, rows)


def print_scan_plan(passes: list[ScanPass]) -> ExitCode:
    """The first question of each pass, byte for byte, and how often it would be asked."""
    from drivebus.cli.dry_run import plan_frames as plan_frames
    from drivebus.commissioning.scan import probe_request
    from drivebus.drives.dialects.create import create_dialect

    documents = []
    for one in passes:
        candidate = one.candidates[0]
        if not one.addresses:
            continue
        dialect = create_dialect(candidate.profile, one.addresses[0], encoding=candidate.encoding)
        frame = plan_frames(
            "scan", [probe_request(dialect)], dialect.station_config.codec, dialect.station_config.timing, one.settings
        )[0]
        where = {"line": str(one.settings), "family": candidate.profile.family, "encoding": candidate.encoding}
        documents.append(where | {"questions": one.probe_count, "seconds": round(one.duration_s, 3)} | frame.to_json())
        output.print_message(
            "scan.pass",
            hex=output.to_json_value(frame.data),
            time=format_duration(one.duration_s),
            count=one.probe_count,
            **where,
        )
    total = sum(one.duration_s for one in passes)
    output.print_json({"dry_run": True, "passes": documents, "seconds": round(total, 3)})
    output.print_message("scan.total", time=format_duration(total))
    return ExitCode.DONE
