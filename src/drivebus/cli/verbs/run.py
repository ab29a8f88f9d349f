"""``run``: start a drive and stay attached; whatever ends the verb stops the drive, unless ``--detach`` was said."""

from __future__ import annotations

import asyncio
import sys
from typing import TYPE_CHECKING, Any

import click

from drivebus.cli import connect, options, voice
from drivebus.cli.command import Option
from drivebus.cli.connect import Target
from drivebus.cli.drive_verb import drive_verb, tell
from drivebus.cli.exits import Exit

if TYPE_CHECKING:
    from drivebus.bus import Bus
    from drivebus.cli.dry import DryRun
    from drivebus.cli.ending import Ending
    from drivebus.drives import Drive
    from drivebus.drives.dialect import Dialect
    from drivebus.drives.state import Direction, DriveStatus
    from drivebus.profiles import DriveProfile

PERIOD_S = 0.5
"""Between two looks at the drive; each look is a few frames."""
OFF_TWICE = 2
"""Two looks must agree that the output is off before the user hears that the drive stopped by itself."""


async def _run(target: Target, frequency: float, reverse: bool, wait: bool, detach: bool) -> Exit:
    from drivebus.cli.ending import listening, mute

    with listening() as ending:
        async with connect.drive(target) as (bus, drive):
            if detach:
                await _say_comm_loss(drive)
            try:
                ended = await _attached(bus, drive, ending, frequency, _direction(reverse), wait, detach)
            except OSError:  # nobody reads what we print any more: the terminal or the pipe is gone
                mute()
                ended = Exit.INTERRUPTED
            except BaseException as error:
                if not nothing_moved(error):
                    await drive.stop()
                raise
            if ended is None:
                return Exit.DONE
            return await _stop(bus, drive, Exit.INTERRUPTED if ending.come else ended)


async def _attached(
    bus: Bus, drive: Drive, ending: Ending, frequency_hz: float, direction: Direction | None, wait: bool, detach: bool
) -> Exit | None:
    """Start and show. Returns why it ended; None where the drive is left running on purpose."""
    started = await _start(bus, drive, ending, frequency_hz, direction, wait, detach)
    if detach and started is Exit.DONE and not ending.come:
        voice.tell("run.detached")
        return None
    return await _watch(bus, drive, ending) if started is Exit.DONE else started


def _direction(reverse: bool) -> Direction | None:
    from drivebus.drives.state import Direction

    return Direction.REVERSE if reverse else None


async def _start(
    bus: Bus, drive: Drive, ending: Ending, frequency_hz: float, direction: Direction | None, wait: bool, detach: bool
) -> Exit:
    """Start. What was refused before anything left is raised; anything else that goes wrong is followed by a stop."""
    from drivebus.cli import exits
    from drivebus.errors import DrivebusError

    try:
        outcome = await ending.race(drive.run(frequency_hz, direction, wait=wait))
    except DrivebusError as error:
        if nothing_moved(error):
            raise
        return exits.report(error)
    if outcome is None:
        return Exit.INTERRUPTED
    code = tell(outcome, bus.now(), event="started", stream=True)
    if code is Exit.DONE and not detach:
        voice.tell("run.attached")
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
        errors.GateError,
        errors.Expired,
        errors.PortUnavailable,
        errors.Refused,
        errors.PlantError,
    )
    return isinstance(error, never_sent) or (isinstance(error, errors.BusError) and error.outcome is None)


async def _watch(bus: Bus, drive: Drive, ending: Ending) -> Exit:
    """Show the drive until the end comes, a fault, or its output is off by somebody else's hand."""
    from drivebus.errors import BusError, ServiceUnavailable

    off = 0
    while not ending.come:
        try:
            status = await ending.race(drive.status())
        except (BusError, ServiceUnavailable) as error:
            _show_text(error.text(voice.language()))
            await ending.wait(PERIOD_S)
            continue
        if status is None:
            break
        _show(bus, status, drive.profile)
        off = off + 1 if status.state.output_off else 0
        if status.fault is not None or off >= OFF_TWICE:
            click.echo()
            voice.tell("run.fault" if status.fault is not None else "run.off_by_itself")
            return Exit.REFUSED
        await ending.wait(PERIOD_S)
    return Exit.INTERRUPTED


def _show(bus: Bus, status: DriveStatus, profile: DriveProfile) -> None:
    from drivebus.cli.live.model import status_document
    from drivebus.cli.outcome import status_line

    voice.document({"event": "status"} | status_document(status, bus.now()), stream=True)
    _show_text(status_line(status, profile))


def _show_text(text: str) -> None:
    """Redraw one line on a terminal; print a line elsewhere."""
    if voice.as_json():
        return
    if sys.stdout.isatty():
        import shutil

        from drivebus.cli.layout import wrap

        line = (wrap(text, shutil.get_terminal_size().columns - 1) or [""])[0]
        click.echo(f"\r\x1b[K{line}", nl=False)
    else:
        click.echo(text)


async def _stop(bus: Bus, drive: Drive, code: Exit) -> Exit:
    """Stop and confirm; an unconfirmed stop outweighs every other ending. Words never come before the stop."""
    from drivebus.cli.ending import mute

    stopping = asyncio.ensure_future(drive.stop(wait=True))
    await asyncio.sleep(0)
    try:
        if sys.stdout.isatty() and not voice.as_json():
            click.echo()
        voice.tell("run.stopping")
    except OSError:
        mute()
    outcome = await stopping
    stopped = tell(outcome, bus.now(), event="stopped", stream=True)
    return code if stopped is Exit.DONE else stopped


async def _say_comm_loss(drive: Drive) -> None:
    """Before a detached start: what the drive itself will do when nobody speaks to it any more (F18)."""
    report = await drive.if_host_dies()
    text = report.text(voice.language())
    voice.document({"event": "comm_loss", "trips": report.trips, "text": text}, stream=True)
    voice.show(voice.wrapped(text, sys.stdout))


def _plan(dry: DryRun, frequency: float, reverse: bool, wait: bool, detach: bool) -> Exit:
    dialect = dry.dialect
    wanted = [dialect.profile.parameters.get(one.notation) for one in dialect.profile.preconditions]
    dry.add("preflight", [dialect.read_parameter(one) for one in wanted if one is not None and one.readable])
    dry.add("state", dialect.state_reads())
    for purpose, frames in start_frames(dialect, frequency, _direction(reverse)):
        dry.add(purpose, [frame.request for frame in frames])
    return dry.show("dry.note.fewer", "dry.note.confirm")


def start_frames(dialect: Dialect, frequency_hz: float, direction: Direction | None) -> list[tuple[str, Any]]:
    """What a start is made of: the frequency first, where the start itself does not carry it."""
    from drivebus.drives.book import Book

    word = dialect.setpoint_word(frequency_hz)
    before = () if dialect.carries_frequency else dialect.set_frequency(word, Book())
    return [("set_frequency", before), ("start", dialect.start(direction, word))]


command = drive_verb(
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
