"""``loopback``: test the line to a drive with requests that it returns unchanged."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivebus.cli import connect, options, output
from drivebus.cli.click_ext import Option
from drivebus.cli.connect import Target
from drivebus.cli.drive_command import drive_command
from drivebus.cli.errors import ExitCode

if TYPE_CHECKING:
    from drivebus.cli.dry_run import DryRun
    from drivebus.drives.operations.loopback import LoopbackReport

MAX_LOOPBACKS = 10_000


async def _loopback(target: Target, count: int) -> ExitCode:
    from drivebus.cli.signals import shutdown_signals

    async with connect.open_drive(target) as (_, drive):
        with shutdown_signals() as shutdown:
            report: LoopbackReport | None
            if target.service is None:
                report = await drive.loopback_test(count, lambda: shutdown.received)
            else:
                report = await shutdown.interruptible(drive.loopback_test(count))
    is_complete = report is not None and report.requests == count
    is_aborted = shutdown.received and not is_complete
    if is_aborted:
        output.print_note("scan.aborted")
    elif not is_complete:
        from drivebus.service.api.operations.drives import LOOPBACK_TIMEOUT_S

        output.print_note("loopback.time_limit", seconds=LOOPBACK_TIMEOUT_S)
    if report is None:
        return ExitCode.INTERRUPTED
    _print_report(report, is_complete=is_complete)
    if is_aborted:
        return ExitCode.INTERRUPTED
    return ExitCode.DONE if len(report.round_trips_s) == count else ExitCode.FAILED


def _print_report(report: LoopbackReport, *, is_complete: bool) -> None:
    lowest_ms, mean_ms, highest_ms = report.round_trip_range_ms or (None, None, None)
    output.print_json(
        {
            "requests": report.requests,
            "returned": len(report.round_trips_s),
            "repetitions": report.repetitions,
            "round_trip_ms": {"min": lowest_ms, "mean": mean_ms, "max": highest_ms},
            "error": None if report.error is None else report.error.text(output.language()),
            "complete": is_complete,
        }
    )
    output.print_wrapped(report.text.in_language(output.language()))


def _plan(dry: DryRun, count: int) -> ExitCode:
    from drivebus.errors import CapabilityError

    modbus = dry.dialect.profile.modbus
    if modbus is None or not modbus.loopback:
        raise CapabilityError("drives.cannot", model=dry.dialect.profile.model, what="loopback")
    dry.add("loopback", [dry.dialect.sync_request() for _ in range(count)])
    return dry.print("dry.note.loopback")


command = drive_command(
    "loopback",
    _loopback,
    _plan,
    extra=(
        Option(["--count"], type=options.NumberType(1, MAX_LOOPBACKS), default=10, metavar="N", example="--count 100"),
    ),
    examples=(
        "drivebus loopback /dev/ttyUSB0 --model vc660 --address 3",
        "drivebus loopback sim://vc660@3 --model vc660 --address 3 --count 100 --json",
        "drivebus loopback --service http://127.0.0.1:8080 --drive pump-1",
    ),
)
