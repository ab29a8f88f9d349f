"""``run``: start a drive and stay attached; the end of the command stops the drive, except with ``--detach``."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeGuard

from drivebus.cli import connect, options, output
from drivebus.cli.click_ext import Option
from drivebus.cli.connect import Target
from drivebus.cli.drive_command import (
    check_start_delay,
    drive_command,
    monotonic_now,
    must_stop_after,
    print_comm_loss,
    print_outcome,
    print_remark,
    stop_and_print,
)
from drivebus.cli.errors import ExitCode
from drivebus.control_characters import without_control_characters

if TYPE_CHECKING:
    from collections.abc import Callable

    from drivebus.bus import Bus
    from drivebus.cli.dry_run import DryRun
    from drivebus.cli.remote.drive import RemoteDrive
    from drivebus.cli.run_watch import RunWatch
    from drivebus.cli.signals import ShutdownSignal
    from drivebus.drives import Drive
    from drivebus.drives.dialects.base import Dialect
    from drivebus.drives.state import Direction, DriveStatus
    from drivebus.profiles import DriveProfile
    from drivebus.types import Json

STATUS_PERIOD_S = 0.5  # between two status reads, a few frames each
OUTPUT_OFF_COUNT = 2  # status reads that must agree before "stopped by itself" is reported


@dataclass(frozen=True, slots=True, kw_only=True)
class RunOptions:
    """Start as the options of ``run`` request it; without a direction it is forward (DF800: as the drive is set)."""

    frequency_hz: float
    direction: Direction | None
    wait: bool
    detach: bool


async def _run(target: Target, frequency: float, *, reverse: bool, wait: bool, detach: bool) -> ExitCode:
    from drivebus.cli.signals import shutdown_signals
    from drivebus.errors import ControlNotHeld

    chosen = RunOptions(frequency_hz=frequency, direction=_direction(reverse=reverse), wait=wait, detach=detach)
    requested_at = monotonic_now()
    with shutdown_signals(may_suspend=False) as shutdown:
        async with connect.open_drive(target) as (bus, drive):
            if detach:
                await print_comm_loss(drive)
            check_start_delay(requested_at)
            try:
                code = await _start_and_watch(bus, drive, shutdown, chosen)
            except OSError:  # the terminal or the pipe is gone
                code = ExitCode.INTERRUPTED
            except ControlNotHeld:  # another user commands the drive
                raise
            except BaseException as error:
                if must_stop_after(error):
                    await drive.stop()
                raise
            if code is None:
                return ExitCode.DONE
            return await stop_and_print(bus, drive, ExitCode.INTERRUPTED if shutdown.received else code)


async def _start_and_watch(bus: Bus, drive: Drive, shutdown: ShutdownSignal, chosen: RunOptions) -> ExitCode | None:
    """Start and show the drive. Return the exit code; None if the drive keeps running with ``--detach``.

    After the start a stop follows whatever fails, so that it is not raised; but another user who has taken control
    commands the drive from then on (ControlNotHeld).
    """
    from drivebus.cli.errors import report_error
    from drivebus.errors import ControlNotHeld, DrivebusError

    started = await _start(bus, drive, shutdown, chosen)
    if chosen.detach and started is ExitCode.DONE and not shutdown.received:
        output.print_message(_detached_key(bus, drive))
        return None
    if started is not ExitCode.DONE:
        return started
    from drivebus.cli.run_watch import RunWatch
    from drivebus.drives.state import Direction

    watch = RunWatch(chosen.frequency_hz, chosen.direction or Direction.FORWARD, bus.now())
    try:
        return await _watch(bus, drive, shutdown, watch)
    except DrivebusError as error:
        output.end_live_line()
        if isinstance(error, ControlNotHeld):
            output.print_note("run.control_lost")
            raise
        return report_error(error)


def _direction(*, reverse: bool) -> Direction | None:
    from drivebus.drives.state import Direction

    return Direction.REVERSE if reverse else None


async def _start(bus: Bus, drive: Drive, shutdown: ShutdownSignal, chosen: RunOptions) -> ExitCode:
    """Start the drive. An error that leaves no motor running is raised; any other is printed, and a stop follows."""
    from drivebus.cli.errors import report_error
    from drivebus.errors import DrivebusError

    waiting: dict[str, Any] = {"wait": True, "on_progress": _progress_printer(bus, drive)} if chosen.wait else {}
    try:
        outcome = await shutdown.interruptible(drive.run(chosen.frequency_hz, chosen.direction, **waiting))
    except DrivebusError as error:
        if not must_stop_after(error):
            raise
        if chosen.wait:
            output.end_live_line()
        return report_error(error)
    if outcome is None:
        return ExitCode.INTERRUPTED
    if chosen.wait:
        output.end_live_line()
    code = print_outcome(outcome, bus.now(), event="started", stream=True)
    if code is ExitCode.DONE and not chosen.detach:
        output.print_message("run.attached_service" if _is_remote(drive) else "run.attached")
    return code


def _progress_printer(bus: Bus, drive: Drive) -> Callable[[DriveStatus], None]:
    """Return a function that prints a status, at most every ``STATUS_PERIOD_S``."""
    printed_at = -STATUS_PERIOD_S

    def print_progress(status: DriveStatus) -> None:
        nonlocal printed_at
        if bus.now() - printed_at >= STATUS_PERIOD_S:
            printed_at = bus.now()
            _print_status(bus, status, drive.profile)

    return print_progress


async def _watch(bus: Bus, drive: Drive, shutdown: ShutdownSignal, watch: RunWatch) -> ExitCode:
    """Show the drive until a shutdown, a fault, or an output that another source switched off."""
    from drivebus.cli.formatting import fault_text
    from drivebus.errors import BusError, ProtocolError, ServiceUnavailable

    off = 0
    while not shutdown.received:
        try:
            status = await shutdown.interruptible(drive.status())
        except (BusError, ProtocolError, ServiceUnavailable) as error:
            if remark := watch.on_failure(error, bus.now()):
                print_remark(remark)
            await shutdown.wait(STATUS_PERIOD_S)
            continue
        if status is None:
            break
        _print_status(bus, status, drive.profile)
        for remark in watch.update(status, bus.now()):
            print_remark(remark)
        off = off + 1 if status.state.output_off else 0
        if status.fault is not None or off >= OUTPUT_OFF_COUNT:
            output.end_live_line()
            if status.fault is not None:
                output.print_message("run.fault", fault=fault_text(status.fault))
            elif last_stop := _last_stop(drive):
                key = "run.stopped_automatically" if last_stop["kind"] == "automatic" else "run.stopped_by"
                output.print_message(key, actor=last_stop["actor"])
            else:
                output.print_message("run.off_by_itself")
            return ExitCode.FAILED
        await shutdown.wait(STATUS_PERIOD_S)
    return ExitCode.INTERRUPTED


def _detached_key(bus: Bus, drive: Drive) -> str:
    """Return the key of the sentence on what becomes of a started drive after the command."""
    if _is_remote(drive):
        return "run.detached_service"
    return "run.detached_simulated" if bus.port.url.startswith("sim:") else "run.detached"


def _is_remote(drive: Drive) -> TypeGuard[RemoteDrive]:
    """Return whether a service runs this drive."""
    from drivebus.cli.remote.drive import RemoteDrive

    return isinstance(drive, RemoteDrive)


def _last_stop(drive: Drive) -> Json | None:
    """Return the stop that was requested through the service after the start; None also without a service."""
    return drive.last_stop if _is_remote(drive) else None


def _print_status(bus: Bus, status: DriveStatus, profile: DriveProfile) -> None:
    """Print a status; none while the reader of the output does not read."""
    from drivebus.cli.formatting import status_json, status_line

    if output.is_blocked():
        return
    output.print_json({"event": "status"} | status_json(status, bus.now()), stream=True)
    _redraw(status_line(status, profile))


def _redraw(text: str) -> None:
    """Redraw one line on a terminal; print a line elsewhere."""
    if output.as_json():
        return
    if sys.stdout.isatty():
        line = (output.wrap(text, output.terminal_width(sys.stdout)) or [""])[0]
        output.echo(f"\r\x1b[K{without_control_characters(line)}", nl=False, controls=True)
    else:
        output.echo(text)


def _plan(dry: DryRun, frequency: float, *, reverse: bool, wait: bool, detach: bool) -> ExitCode:
    from drivebus.drives.operations.start import check_run

    dialect, direction = dry.dialect, _direction(reverse=reverse)
    dry.check_then_assume_scale(lambda: check_run(dry.drive, frequency, direction, will_wait=wait))
    dry.add_readiness()
    dry.add_start_preparation()
    for purpose, frames in start_frames(dialect, frequency, direction):
        dry.add(purpose, [frame.request for frame in frames])
    at_zero = dry.drive.check_frequency(frequency)[1] == 0.0
    return dry.print(*(["drives.run_at_zero"] if at_zero else ()), "dry.note.fewer", "dry.note.confirm")


def start_frames(dialect: Dialect, frequency_hz: float, direction: Direction | None) -> list[tuple[str, Any]]:
    """Return the frames of a start: the frequency first, unless the start frame includes it."""
    from drivebus.drives.readings import ReadingPairs

    word = dialect.setpoint_word(frequency_hz)
    before = () if dialect.start_includes_setpoint else dialect.set_frequency(word, ReadingPairs())
    return [("set_frequency", before), ("start", dialect.start(direction, word))]


command = drive_command(
    "run",
    _run,
    _plan,
    stays_attached=True,
    extra=(
        Option(["--frequency"], type=options.FREQUENCY, required=True, metavar="HZ", example="--frequency 25"),
        Option(["--reverse"], is_flag=True),
        Option(["--wait"], is_flag=True),
        Option(["--detach"], is_flag=True),
    ),
    examples=(
        "drivebus run /dev/ttyUSB0 --model c320 --address 1 --frequency 25",
        "drivebus run /dev/ttyUSB0 --model vc660 --address 3 --frequency 10 --reverse",
        "drivebus run sim://c320@1 --model c320 --address 1 --frequency 50 --detach",
        "drivebus run /dev/ttyUSB0 --model df800 --address 2 --frequency 5 --dry-run",
        "drivebus run --service http://127.0.0.1:8080 --drive fan-1 --frequency 25",
    ),
)
