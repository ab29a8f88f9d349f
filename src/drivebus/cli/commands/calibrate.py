"""``calibrate``: determine on the drive what its manual leaves open. Asks before each step, stores the results."""

from __future__ import annotations

import sys
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from drivebus.cli import connect, output
from drivebus.cli.connect import Target
from drivebus.cli.drive_command import drive_command, nothing_moved, print_outcome
from drivebus.cli.errors import ExitCode

if TYPE_CHECKING:
    from drivebus.bus import Bus
    from drivebus.cli.dry_run import DryRun
    from drivebus.cli.keyboard import KeyQueue
    from drivebus.cli.signals import ShutdownSignal
    from drivebus.drives import Drive
    from drivebus.drives.operations.calibration import ScalingResult
    from drivebus.drives.outcome import Outcome
    from drivebus.drives.state import Direction

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class CalibrationSession:
    """The drive, and the keyboard of the person beside it."""

    bus: Bus
    drive: Drive
    keys: KeyQueue
    shutdown: ShutdownSignal

    async def key(self, question: str, **params: Any) -> str | None:
        """Print a question and return the next key; None if the shutdown is requested first."""
        self.keys.clear()
        output.print_note(question, **params)
        return await self.shutdown.interruptible(self.keys.get())

    async def confirmed(self, question: str, **params: Any) -> bool:
        """Return whether the answer is y."""
        return await self.key(question, **params) in ("y", "Y")


Step = Callable[[CalibrationSession], Awaitable[ExitCode]]


async def _calibrate(target: Target) -> ExitCode:
    from drivebus.cli.keyboard import raw_keyboard
    from drivebus.cli.signals import shutdown_signals
    from drivebus.errors import ConfigurationError

    if not sys.stdin.isatty():
        raise ConfigurationError("calibrate.no_terminal")
    with shutdown_signals() as shutdown:
        async with connect.open_drive(target) as (bus, drive):
            steps = remaining_steps(drive.dialect.settings)
            if not steps:
                output.print_json({"event": "nothing", "settings": drive.dialect.settings}, stream=True)
                output.print_message("calibrate.nothing", model=drive.profile.model)
            with raw_keyboard() as keys:
                return await _run_steps(CalibrationSession(bus, drive, keys, shutdown), steps)


def remaining_steps(settings: Mapping[str, Any]) -> list[Step]:
    """Return the open steps, in the order of their dependencies."""
    steps: list[Step] = [_query_coding] if settings.get("query_coding") == "unknown" else []
    steps += [_setpoint_coding] if settings.get("setpoint_coding") == "unknown" else []
    return steps + ([_direction] if settings.get("direction_proved") is False else [])


async def _run_steps(session: CalibrationSession, steps: list[Step]) -> ExitCode:
    for step in steps:
        code = await step(session)
        if code is not ExitCode.DONE:
            return code
    return ExitCode.DONE


async def _query_coding(session: CalibrationSession) -> ExitCode:
    """Determine the scaling of the reported frequency; sends only reads."""
    from drivebus.drives.operations.calibration import DEFAULT_KEYPAD_HZ

    if not await session.confirmed("calibrate.ask_query", keypad_hz=DEFAULT_KEYPAD_HZ):
        return ExitCode.INTERRUPTED
    return _print_scaling(session, "query_coding", await session.drive.calibrate_query_coding(DEFAULT_KEYPAD_HZ))


async def _setpoint_coding(session: CalibrationSession) -> ExitCode:
    from drivebus.drives.dialects.dzb100 import UNCALIBRATED_CAP_HZ
    from drivebus.drives.operations.calibration import CALIBRATION_RUN_S

    if not await session.confirmed("calibrate.ask_setpoint", cap_hz=UNCALIBRATED_CAP_HZ, seconds=CALIBRATION_RUN_S):
        return ExitCode.INTERRUPTED
    found = await _run_motion(session, session.drive.calibrate_setpoint_coding())
    return ExitCode.INTERRUPTED if found is None else _print_scaling(session, "setpoint_coding", found)


async def _direction(session: CalibrationSession) -> ExitCode:
    from drivebus.drives.operations.calibration import CALIBRATION_JOG_S, MAX_CALIBRATION_JOG_HZ
    from drivebus.drives.state import Direction

    ways = {"f": Direction.FORWARD, "r": Direction.REVERSE}

    async def watched() -> Direction | None:
        return ways.get((await session.key("calibrate.ask_way") or "").lower())

    if not await session.confirmed("calibrate.ask_jog", cap_hz=MAX_CALIBRATION_JOG_HZ, seconds=CALIBRATION_JOG_S):
        return ExitCode.INTERRUPTED
    outcome = await _run_motion(session, session.drive.calibrate_direction(MAX_CALIBRATION_JOG_HZ, watched))
    return ExitCode.INTERRUPTED if outcome is None else _print_direction(session, outcome)


async def _run_motion(session: CalibrationSession, step: Awaitable[T]) -> T | None:
    """Run a step that moves the motor; stop the drive if it ends early. None: the user ended it."""
    try:
        found = await session.shutdown.interruptible(step)
    except BaseException as error:
        if not nothing_moved(error):
            await session.drive.stop()
        raise
    if found is None:
        print_outcome(await session.drive.stop(), session.bus.now(), event="stopped", stream=True)
    return found


def _print_scaling(session: CalibrationSession, setting: str, found: ScalingResult) -> ExitCode:
    words = [f"{word:04X}H" for word in found.words]
    if found.coding is None:
        output.print_json({"event": "open", "setting": setting, "left": found.codings, "words": words}, stream=True)
        output.print_message(
            "calibrate.open", setting=setting, codings=", ".join(found.codings), words=", ".join(words)
        )
        return ExitCode.FAILED
    return _print_stored(session, {setting: found.coding}, words=words)


def _print_direction(session: CalibrationSession, outcome: Outcome) -> ExitCode:
    settings = session.drive.dialect.settings
    print_outcome(outcome, session.bus.now(), event="jogged", stream=True)
    if settings["direction_proved"] is not True:
        output.print_message("calibrate.unseen")
        return ExitCode.FAILED
    return _print_stored(session, {name: settings[name] for name in ("direction_field", "direction_proved")})


def _print_stored(session: CalibrationSession, settings: dict[str, Any], **more: Any) -> ExitCode:
    """Print the result, and whether it is stored for later commands."""
    from drivebus.drives.drive import VOLATILE_SCHEMES

    stored = session.bus.port.url.partition(":")[0] not in VOLATILE_SCHEMES
    output.print_json({"event": "calibrated", "settings": settings, "stored": stored} | more, stream=True)
    for name, value in settings.items():
        output.print_message("calibrate.result", setting=name, value=str(value).lower())
    output.print_message("calibrate.stored" if stored else "calibrate.not_stored")
    return ExitCode.DONE


def _plan(dry: DryRun) -> ExitCode:
    from drivebus.drives.dialects.base import StopMode
    from drivebus.drives.dialects.dzb100 import Dzb100Dialect, highest_safe_word, possible_codings
    from drivebus.drives.dialects.modbus import ModbusDialect
    from drivebus.drives.operations.calibration import MAX_CALIBRATION_JOG_HZ
    from drivebus.drives.readings import ReadingPairs

    steps, dialect = remaining_steps(dry.dialect.settings), dry.dialect
    if isinstance(dialect, Dzb100Dialect) and steps:
        dry.add("state", [dialect.query(0), dialect.query(1)])
    if isinstance(dialect, Dzb100Dialect) and _setpoint_coding in steps:
        dry.add(
            "start",
            [frame.request for frame in dialect.start(None, highest_safe_word(possible_codings(dialect.settings)))],
        )
    if isinstance(dialect, ModbusDialect) and _direction in steps:
        word = dialect.setpoint_word(MAX_CALIBRATION_JOG_HZ)
        dry.add("set_frequency", [frame.request for frame in dialect.set_frequency(word, ReadingPairs())])
        dry.add("jog_once", [frame.request for frame in dialect.calibration_jog()])
    if steps:
        dry.add("stop", dialect.stop(StopMode.STOP))
    return dry.print("dry.note.fewer", "dry.note.confirm")


command = drive_command(
    "calibrate",
    _calibrate,
    _plan,
    examples=(
        "drivebus calibrate /dev/ttyUSB0 --model dzb100 --address 1",
        "drivebus calibrate /dev/ttyUSB0 --model df800 --address 2",
        "drivebus calibrate /dev/ttyUSB0 --model df800 --address 2 --dry-run",
    ),
)
