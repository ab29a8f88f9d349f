"""``run``: start a drive and stay attached; whatever ends the verb stops the drive, unless ``--detach`` was said."""

from __future__ import annotations

import asyncio
import sys
from typing import TYPE_CHECKING, Any

import click

from drivebus.cli import connect, options, output
from drivebus.cli.click_ext import Option
from drivebus.cli.connect import Target
from drivebus.cli.drive_command import drive_command, print_outcome
from drivebus.cli.errors import ExitCode

if TYPE_CHECKING:
    from drivebus.bus import Bus
    from drivebus.cli.dry_run import DryRun
    from drivebus.cli.signals import ShutdownSignal
    from drivebus.drives import Drive
    from drivebus.drives.dialects.base import Dialect
    from drivebus.drives.state import Direction, DriveStatus
    from drivebus.profiles import DriveProfile

PERIOD_S = 0.5
"""Between two looks at the drive; each look is a few frames."""
OUTPUT_OFF_COUNT = 2
"""Two looks must agree that the output is off before the user hears that the drive stopped by itself."""


async def _run(target: Target, frequency: float, reverse: bool, wait: bool, detach: bool) -> ExitCode:
    from drivebus.cli.signals import discard_output, shutdown_signals

    with shutdown_signals() as ending:
        async with connect.open_drive(target) as (bus, drive):
            if detach:
                await _print_comm_loss(drive)
            try:
                ended = await _attached(bus, drive, ending, frequency, _direction(reverse), wait, detach)
            except OSError:  # nobody reads what we print any more: the terminal or the pipe is gone
                discard_output()
                ended = ExitCode.INTERRUPTED
            except BaseException as error:
                if not nothing_moved(error):
                    await drive.stop()
                raise
            if ended is None:
                return ExitCode.DONE
            return await _stop(bus, drive, ExitCode.INTERRUPTED if ending.received else ended)


async def _attached(
    bus: Bus,
    drive: Drive,
    ending: ShutdownSignal,
    frequency_hz: float,
    direction: Direction | None,
    wait: bool,
    detach: bool,
) -> ExitCode | None:
    """Start and show. Returns why it ended; None where the drive is left running on purpose."""
    started = await _start(bus, drive, ending, frequency_hz, direction, wait, detach)
    if detach and started is ExitCode.DONE and not ending.received:
        output.print_message("run.detached")
        return None
    return await _watch(bus, drive, ending) if started is ExitCode.DONE else started


def _direction(reverse: bool) -> Direction | None:
    from drivebus.drives.state import Direction

    return Direction.REVERSE if reverse else None


async def _start(
    bus: Bus,
    drive: Drive,
    ending: ShutdownSignal,
    frequency_hz: float,
    direction: Direction | None,
    wait: bool,
    detach: bool,
) -> ExitCode:
    """Start. What was refused before anything left is raised; anything else that goes wrong is followed by a stop."""
    from drivebus.cli import errors as exits
    from drivebus.errors import DrivebusError

    try:
        outcome = await ending.interruptible(drive.run(frequency_hz, direction, wait=wait))
    except DrivebusError as error:
        if nothing_moved(error):
            raise
        return exits.report_error(error)
    if outcome is None:
        return ExitCode.INTERRUPTED
    code = print_outcome(outcome, bus.now(), event="started", stream=True)
    if code is ExitCode.DONE and not detach:
        output.print_message("run.attached")
    return code


def nothing_moved(error: BaseException) -> bool:
    """Nothing left the host that may move a motor, or the drive itself said no: there is nothing to stop.

    A service that says no has sent nothing; one that has lost our lease lets somebody else command the drive.
    """
    from drivebus import errors

    never_sent = (
        errors.ConfigurationError,
        errors.CapabilityError,
        errors.LimitError,
        errors.PreflightError,
        errors.StartInhibited,
        errors.Expired,
        errors.PortUnavailable,
        errors.DriveRejected,
        errors.ServiceError,
    )
    return isinstance(error, never_sent) or (isinstance(error, errors.BusError) and error.outcome is None)


async def _watch(bus: Bus, drive: Drive, ending: ShutdownSignal) -> ExitCode:
    """Show the drive until the end comes, a fault, or its output is off by somebody else's hand."""
    from drivebus.errors import BusError, ServiceUnavailable

    off = 0
    while not ending.received:
        try:
            status = await ending.interruptible(drive.status())
        except (BusError, ServiceUnavailable) as error:
            _redraw(error.text(output.language()))
            await ending.wait(PERIOD_S)
            continue
        if status is None:
            break
        _print_status(bus, status, drive.profile)
        off = off + 1 if status.state.output_off else 0
        if status.fault is not None or off >= OUTPUT_OFF_COUNT:
            click.echo()
            output.print_message("run.fault" if status.fault is not None else "run.off_by_itself")
            return ExitCode.FAILED
        await ending.wait(PERIOD_S)
    return ExitCode.INTERRUPTED


def _print_status(bus: Bus, status: DriveStatus, profile: DriveProfile) -> None:
    from drivebus.cli.formatting import status_line
    from drivebus.cli.tui.rows import status_json

    output.print_json({"event": "status"} | status_json(status, bus.now()), stream=True)
    _redraw(status_line(status, profile))


def _redraw(text: str) -> None:
    """Redraw one line on a terminal; print a line elsewhere."""
    if output.as_json():
        return
    if sys.stdout.isatty():
        import shutil

        from drivebus.cli.text_layout import wrap

        line = (wrap(text, shutil.get_terminal_size().columns - 1) or [""])[0]
        click.echo(f"\r\x1b[K{line}", nl=False)
    else:
        click.echo(text)


async def _stop(bus: Bus, drive: Drive, code: ExitCode) -> ExitCode:
    """Stop and confirm; an unconfirmed stop outweighs every other ending. Words never come before the stop."""
    from drivebus.cli.signals import discard_output

    stopping = asyncio.ensure_future(drive.stop(wait=True))
    await asyncio.sleep(0)
    try:
        if sys.stdout.isatty() and not output.as_json():
            click.echo()
        output.print_message("run.stopping")
    except OSError:
        discard_output()
    outcome = await stopping
    stopped = print_outcome(outcome, bus.now(), event="stopped", stream=True)
    return code if stopped is ExitCode.DONE else stopped


async def _print_comm_loss(drive: Drive) -> None:
    """Before a detached start: what the drive itself will do when nobody speaks to it any more (F18)."""
    report = await drive.comm_loss_behaviour()
    text = report.text(output.language())
    output.print_json({"event": "comm_loss", "trips": report.stops_on_comm_loss, "text": text}, stream=True)
    output.print_text(output.wrap_for(text, sys.stdout))


def _plan(dry: DryRun, frequency: float, reverse: bool, wait: bool, detach: bool) -> ExitCode:
    dialect = dry.dialect
    wanted = [dialect.profile.parameters.get(one.notation) for one in dialect.profile.preconditions]
    dry.add("preflight", [dialect.read_parameter(one) for one in wanted if one is not None and one.readable])
    dry.add("state", dialect.state_reads())
    for purpose, frames in start_frames(dialect, frequency, _direction(reverse)):
        dry.add(purpose, [frame.request for frame in frames])
    return dry.print("dry.note.fewer", "dry.note.confirm")


def start_frames(dialect: Dialect, frequency_hz: float, direction: Direction | None) -> list[tuple[str, Any]]:
    """What a start is made of: the frequency first, where the start itself does not carry it."""
    from drivebus.drives.readings import ReadingPairs

    word = dialect.setpoint_word(frequency_hz)
    before = () if dialect.start_includes_setpoint else dialect.set_frequency(word, ReadingPairs())
    return [("set_frequency", before), ("start", dialect.start(direction, word))]


command = drive_command(
    "run",
    _run,
    _plan,
    extra=(
        Option(["--frequency"], type=options.FREQUENCY, required=True, metavar="HZ", example="--frequency 25"),
        Option(["--reverse"], is_flag=True),
        Option(["--wait"], is_flag=True),
        Option(["--detach"], is_flag=True),
    ),
    examples=(
        "drivebus run /dev/ttyUSB0 --model c320 --address 1 --frequency 25",
        "drivebus run /dev/ttyUSB0 --model vc660 --address 3 --frequency 10 --reverse --wait",
        "drivebus run sim://c320@1 --model c320 --address 1 --frequency 50 --detach",
        "drivebus run /dev/ttyUSB0 --model df800 --address 2 --frequency 5 --dry-run",
        "drivebus run --service http://127.0.0.1:8080 --drive fan-1 --frequency 25",
    ),
)
