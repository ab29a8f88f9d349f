"""``jog``: the motor turns while a key is held. The terminal's key repeat renews a lease; silence stops it (T13).

One press alone starts nothing: only the key's repeat shows that a hand holds it.
"""

from __future__ import annotations

import asyncio
import sys
from typing import TYPE_CHECKING, Any

from drivebus.cli import connect, options, output
from drivebus.cli.click_ext import Option
from drivebus.cli.connect import Target
from drivebus.cli.drive_command import drive_command
from drivebus.cli.errors import ExitCode

if TYPE_CHECKING:
    from drivebus.bus import Bus
    from drivebus.cli.dry_run import DryRun
    from drivebus.cli.keyboard import KeyQueue
    from drivebus.cli.signals import ShutdownSignal
    from drivebus.drives import Drive
    from drivebus.drives.state import Direction, Outcome

LEASE_S = 0.5
"""No motion outlives the hand on the key by more (T13)."""
FIRST_REPEAT_TIMEOUT_S = 1.0
"""Terminals repeat a held key after 0.25 to 0.66 s for the first time."""
FORWARD, REVERSE, QUIT = frozenset(" f"), frozenset("r"), frozenset("q\x1b\x03\x04")


async def _jog(target: Target, frequency: float | None) -> ExitCode:
    from drivebus.cli.keyboard import raw_keyboard
    from drivebus.cli.signals import shutdown_signals
    from drivebus.errors import ConfigurationError

    if not sys.stdin.isatty():
        raise ConfigurationError("jog.no_terminal")
    with shutdown_signals() as ending:
        async with connect.open_drive(target) as (bus, drive):
            with raw_keyboard() as keys:
                output.print_message("jog.how")
                await _until_quit(bus, drive, keys, ending, frequency)
    return ExitCode.INTERRUPTED if ending.received else ExitCode.DONE


async def _until_quit(
    bus: Bus, drive: Drive, keys: KeyQueue, ending: ShutdownSignal, frequency_hz: float | None
) -> None:
    while not ending.received:
        key = await ending.interruptible(keys.get())
        if key is None or key in QUIT:
            return
        direction = _direction(key)
        if direction is not None and await _is_held(keys, key):
            await _jog_while_held(bus, drive, keys, ending, key, frequency_hz, direction)
            keys.clear()


def _direction(key: str) -> Direction | None:
    from drivebus.drives.state import Direction

    return Direction.FORWARD if key in FORWARD else Direction.REVERSE if key in REVERSE else None


async def _is_held(keys: KeyQueue, key: str) -> bool:
    """The same key comes again soon: it is held."""
    try:
        return await keys.get(FIRST_REPEAT_TIMEOUT_S) == key
    except TimeoutError:
        return False


async def _jog_while_held(
    bus: Bus,
    drive: Drive,
    keys: KeyQueue,
    ending: ShutdownSignal,
    key: str,
    frequency_hz: float | None,
    direction: Direction,
) -> None:
    """Jog as long as the key repeats. Leaving the block stops the drive and confirms it."""
    async with drive.jog(frequency_hz, direction, lease_s=LEASE_S) as lease:
        _print_jog_outcome(lease.start_outcome, bus, "begun")
        loop = asyncio.get_running_loop()
        while not ending.received and keys.last_key == key:
            left_s = keys.last_key_at + LEASE_S - loop.time()
            if left_s <= 0:
                break
            lease.renew()
            pressed = await ending.interruptible(_next_key(keys, left_s))
            if pressed != key:
                break
    _print_jog_outcome(lease.stop_outcome, bus, "ended")


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
    from drivebus.drives.state import Direction

    dialect: Any = dry.dialect
    word = None if frequency is None else dialect.setpoint_word(frequency)
    dry.add("jog", [frame.request for frame in dialect.jog(Direction.FORWARD, word)])
    dry.add("jog_stop", dialect.stop(StopMode.JOG_STOP))
    dry.add("stop", dialect.stop(StopMode.STOP))
    return dry.print("dry.note.confirm")


command = drive_command(
    "jog",
    _jog,
    _plan,
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
