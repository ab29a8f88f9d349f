"""``loopback``: test the line to a drive with requests that it returns unchanged."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from drivebus.cli import connect, options, output
from drivebus.cli.click_ext import CliCommand, Option
from drivebus.cli.connect import Target
from drivebus.cli.drive_command import pop_target
from drivebus.cli.errors import ExitCode

if TYPE_CHECKING:
    from drivebus.cli.dry_run import DryRun
    from drivebus.drives.operations.loopback import LoopbackReport

MAX_LOOPBACKS = 10_000


def _run(*, count: int, dry_run: bool, **arguments: Any) -> ExitCode:
    import asyncio

    target = pop_target(arguments)
    if dry_run:
        from drivebus.cli.dry_run import DryRun

        return _plan(DryRun(target), count)
    return asyncio.run(_loopback(target, count))


async def _loopback(target: Target, count: int) -> ExitCode:
    from drivebus.cli.signals import shutdown_signals

    async with connect.open_drive(target) as (_, drive):
        with shutdown_signals() as shutdown:
            report = await drive.loopback_test(count, lambda: shutdown.received)
    is_complete = report.requests == count
    if not is_complete:
        output.print_note("scan.aborted")
    _print_report(report, is_complete=is_complete)
    if not is_complete:
        return ExitCode.INTERRUPTED
    return ExitCode.DONE if len(report.round_trips_s) == count else ExitCode.FAILED


def _print_report(report: LoopbackReport, *, is_complete: bool) -> None:
    times_ms = sorted(round(1000 * round_trip_s, 1) for round_trip_s in report.round_trips_s)
    mean_ms = round(sum(times_ms) / len(times_ms), 1) if times_ms else None
    lowest_ms, highest_ms = (times_ms[0], times_ms[-1]) if times_ms else (None, None)
    error = None if report.error is None else report.error.text(output.language())
    output.print_json(
        {
            "requests": report.requests,
            "returned": len(times_ms),
            "repetitions": report.repetitions,
            "round_trip_ms": {"min": lowest_ms, "mean": mean_ms, "max": highest_ms},
            "error": error,
            "complete": is_complete,
        }
    )
    sentences = [output.text("loopback.returned", returned=len(times_ms), requests=report.requests)]
    if times_ms:
        sentences.append(output.text("loopback.times", low=lowest_ms, mean=mean_ms, high=highest_ms))
    if report.repetitions:
        sentences.append(output.text("loopback.repeated", count=report.repetitions))
    if error is not None:
        sentences.append(output.text("loopback.error", why=error))
    output.print_wrapped(output.join(sentences, "sentences"))


def _plan(dry: DryRun, count: int) -> ExitCode:
    from drivebus.errors import CapabilityError

    modbus = dry.dialect.profile.modbus
    if modbus is None or not modbus.loopback:
        raise CapabilityError("drives.cannot", model=dry.dialect.profile.model, what="loopback")
    dry.add("loopback", [dry.dialect.sync_request() for _ in range(count)])
    return dry.print("dry.note.loopback")


command = CliCommand(
    "loopback",
    callback=_run,
    params=[
        *options.drive_options(),
        Option(["--count"], type=options.NumberType(1, MAX_LOOPBACKS), default=10, metavar="N", example="--count 100"),
        options.dry_run_option(),
    ],
    examples=(
        "drivebus loopback /dev/ttyUSB0 --model vc660 --address 3",
        "drivebus loopback sim://vc660@3 --model vc660 --address 3 --count 100 --json",
    ),
)
