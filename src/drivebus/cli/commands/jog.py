"""``jog``: run the motor while a key is held. The key repeat of the terminal renews a dead-man timer.

A single press starts nothing: only its repeat shows that the key is held.
"""

from __future__ import annotations

import asyncio
import sys
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from drivebus.cli import connect, options, output
from drivebus.cli.click_ext import Option
from drivebus.cli.connect import Target
from drivebus.cli.drive_command import drive_command, print_comm_loss, print_remark
from drivebus.cli.errors import ExitCode
from drivebus.user_input import normalize_answer

if TYPE_CHECKING:
    from drivebus.bus import Bus
    from drivebus.cli.dry_run import DryRun
    from drivebus.cli.keyboard import KeyQueue
    from drivebus.cli.signals import ShutdownSignal
    from drivebus.drives import Drive
    from drivebus.drives.jog_session import JogSession
    from drivebus.drives.outcome import Outcome
    from drivebus.drives.state import Direction

FIRST_REPEAT_TIMEOUT_S = 1.0  # terminals repeat a held key after 0.25 to 0.66 s
DIRECTION_READ_INTERVAL_S = 0.2  # a jog may be short
FORWARD_KEYS = frozenset(" f")
REVERSE_KEYS = frozenset("r")
QUIT_KEYS = frozenset("q\x1b\x03\x04")  # q, Esc, Ctrl-C, Ctrl-D


async def _jog(target: Target, frequency: float | None) -> ExitCode:
    from drivebus.cli.keyboard import raw_keyboard
    from drivebus.cli.signals import shutdown_signals
    from drivebus.drives.operations.jog import MAX_JOG_LEASE_S
    from drivebus.errors import ConfigurationError

    if not sys.stdin.isatty():
        raise ConfigurationError("jog.no_terminal")
    _check_frequency_source(target, frequency)
    with shutdown_signals(may_suspend=False) as shutdown:
        async with connect.open_drive(target) as (bus, drive):
            if frequency is not None and target.service is None:  # the service checks it with the limits of its plant
                drive.check_frequency(frequency)
            await print_comm_loss(drive)
            with raw_keyboard() as keys:
                output.print_message("jog.how", limit_s=MAX_JOG_LEASE_S)
                try:
                    await _until_quit(bus, drive, keys, shutdown, frequency)
                except OSError:  # the terminal or the pipe is gone, and the drive is stopped
                    return ExitCode.INTERRUPTED
    return ExitCode.INTERRUPTED if shutdown.received else ExitCode.DONE


def _check_frequency_source(target: Target, frequency_hz: float | None) -> None:
    """Raise CapabilityError where the model takes the frequency of a jog from elsewhere, or can't jog."""
    from drivebus.drives.dialects.create import create_dialect
    from drivebus.drives.state import Direction
    from drivebus.errors import CapabilityError, StartInhibited

    if target.profile.jog_frequency is None:
        raise CapabilityError("drives.cannot", model=target.model, what="jog")
    with suppress(StartInhibited):  # only the drive, or its service, knows whether its direction is calibrated
        create_dialect(target.profile, target.address).jog(Direction.FORWARD, None if frequency_hz is None else 0)


async def _until_quit(
    bus: Bus, drive: Drive, keys: KeyQueue, shutdown: ShutdownSignal, frequency_hz: float | None
) -> None:
    while not shutdown.received:
        key = await shutdown.interruptible(keys.get())
        if key is None or normalize_answer(key) in QUIT_KEYS:
            return
        direction = _direction(key)
        if direction is not None and await _is_held(bus, keys, key):
            session = drive.jog(frequency_hz, direction)
            await _jog_while_held(session, bus, keys, shutdown, key, drive, direction)
            keys.clear()


def _direction(key: str) -> Direction | None:
    from drivebus.drives.state import Direction

    key = normalize_answer(key)
    return Direction.FORWARD if key in FORWARD_KEYS else Direction.REVERSE if key in REVERSE_KEYS else None


async def _is_held(bus: Bus, keys: KeyQueue, key: str) -> bool:
    """Return whether the same key is repeated soon, by the terminal and not by keys that were read together.

    Those may be old: they waited while the program or the computer was suspended.
    """
    keys.clear()
    pressed_at = bus.now()
    try:
        repeated = await keys.get(FIRST_REPEAT_TIMEOUT_S) == key
    except TimeoutError:
        return False
    return repeated and bus.now() - pressed_at <= FIRST_REPEAT_TIMEOUT_S


async def _watch_direction(drive: Drive, direction: Direction) -> None:
    """Remark once on a drive that reports the other direction; what else fails is reported by the jog itself."""
    from drivebus.cli.run_watch import Remark
    from drivebus.errors import DrivebusError

    while True:
        with suppress(DrivebusError):
            status = await drive.status()
            if status.direction not in (None, direction):
                print_remark(Remark("run.wrong_direction", {"expected": direction, "found": status.direction}))
                return
        await asyncio.sleep(DIRECTION_READ_INTERVAL_S)


async def _jog_while_held(
    session: JogSession,
    bus: Bus,
    keys: KeyQueue,
    shutdown: ShutdownSignal,
    key: str,
    drive: Drive,
    direction: Direction,
) -> None:
    """Jog while the key repeats, then stop the drive and confirm it."""
    from drivebus.drives.operations.jog import MAX_JOG_LEASE_S

    watch: asyncio.Task[None] | None = None
    try:
        async with session:
            _print_jog_outcome(session.start_outcome, bus, "begun")
            loop = asyncio.get_running_loop()
            watch = asyncio.create_task(_watch_direction(drive, direction), name="direction of a jog")
            try:
                while not shutdown.received and keys.last_key == key:
                    left_s = keys.last_key_at + MAX_JOG_LEASE_S - loop.time()
                    if left_s <= 0:
                        break
                    session.renew()
                    pressed = await shutdown.interruptible(_next_key(keys, left_s))
                    if pressed != key:
                        break
            finally:
                watch.cancel()
    finally:  # a renewal that was refused is an error of its own; the stop is not
        if watch is not None:
            await asyncio.gather(watch, return_exceptions=True)
        with output.continue_without_output():
            _print_jog_outcome(session.stop_outcome, bus, "ended")


async def _next_key(keys: KeyQueue, timeout_s: float) -> str | None:
    try:
        return await keys.get(timeout_s)
    except TimeoutError:
        return None


def _print_jog_outcome(outcome: Outcome | None, bus: Bus, event: str) -> None:
    from drivebus.cli.drive_command import print_outcome

    if outcome is not None:
        print_outcome(outcome, bus.now(), stream=True, event=event)


def _plan(dry: DryRun, frequency: float | None) -> ExitCode:
    from drivebus.drives.dialects.base import StopMode
    from drivebus.drives.operations.jog import check_jog
    from drivebus.drives.state import Direction

    dialect: Any = dry.dialect
    if frequency is None:
        dry.check(lambda: check_jog(dry.drive, None, Direction.FORWARD))
    else:
        dry.check_then_assume_scale(lambda: check_jog(dry.drive, frequency, Direction.FORWARD))
    word = None if frequency is None else dialect.setpoint_word(frequency)
    dry.add_readiness()
    dry.add("jog", [frame.request for frame in dialect.jog(Direction.FORWARD, word)])
    dry.add("jog_stop", dialect.stop(StopMode.JOG_STOP))
    dry.add("stop", dialect.stop(StopMode.STOP))
    return dry.print("dry.note.fewer", "dry.note.confirm")


command = drive_command(
    "jog",
    _jog,
    _plan,
    stays_attached=True,
    extra=(
        Option(
            ["--frequency"],
            type=options.FREQUENCY,
            metavar="HZ",
            key="help.option.jog_frequency",
            example="--frequency 5",
        ),
    ),
    examples=(
        "drivebus jog /dev/ttyUSB0 --model c320 --address 1",
        "drivebus jog /dev/ttyUSB0 --model c320 --address 1 --frequency 5",
        "drivebus jog /dev/ttyUSB0 --model vc660 --address 3",
        "drivebus jog --service http://127.0.0.1:8080 --drive fan-1",
    ),
)
