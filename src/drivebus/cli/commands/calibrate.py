"""``calibrate``: determine on the drive what its manual leaves open. Asks before each step, stores the results."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Awaitable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from drivebus.cli import connect, options, output
from drivebus.cli.background_output import background_output
from drivebus.cli.click_ext import CliCommand
from drivebus.cli.connect import Target
from drivebus.cli.drive_command import must_stop_after, pop_target, print_outcome
from drivebus.cli.errors import ExitCode
from drivebus.user_input import normalize_answer

if TYPE_CHECKING:
    from drivebus.bus import Bus
    from drivebus.cli.dry_run import DryRun
    from drivebus.cli.keyboard import KeyQueue
    from drivebus.cli.signals import ShutdownSignal
    from drivebus.drives import Drive
    from drivebus.drives.operations.calibration import CalibrationResult, CalibrationStep

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
        return normalize_answer(await self.key(question, **params) or "") == "y"


async def _calibrate(target: Target) -> ExitCode:
    from drivebus.cli.keyboard import raw_keyboard
    from drivebus.cli.signals import shutdown_signals
    from drivebus.errors import ConfigurationError

    if not sys.stdin.isatty():
        raise ConfigurationError("calibrate.no_terminal")
    with shutdown_signals(may_suspend=False) as shutdown:
        async with connect.open_drive(target) as (bus, drive):
            steps = drive.open_calibrations()
            if not steps:
                output.print_json({"event": "nothing", "options": drive.dialect.options}, stream=True)
                output.print_message("calibrate.nothing", model=drive.profile.model)
                _print_determined(drive)
            with raw_keyboard() as keys:
                session = CalibrationSession(bus, drive, keys, shutdown)
                for step in steps:
                    code = await _run_step(session, step)
                    if code is not ExitCode.DONE:
                        return code
    return ExitCode.DONE


def _print_determined(drive: Drive) -> None:
    """Print what was determined before, and how to determine it again: a keypad may have been misread."""
    from drivebus.drives.operations.calibration import calibration_steps

    for step in calibration_steps(drive.dialect):
        value, undetermined = (
            str(option_value).lower() for option_value in (drive.dialect.options[step.option], step.undetermined)
        )
        output.print_message("calibrate.known", option=step.option, value=value, undetermined=undetermined)


async def _run_step(session: CalibrationSession, step: CalibrationStep) -> ExitCode:
    """Run one step once a person has confirmed it, and print its result."""

    async def observe() -> Any:
        assert step.observation_question is not None
        return step.observations.get(normalize_answer(await session.key(step.observation_question) or ""))

    if not await session.confirmed(step.question, **step.question_params):
        output.print_note("calibrate.not_begun", option=step.option)
        return ExitCode.INTERRUPTED
    calibration = session.drive.calibrate(step.name, observe)
    result = await (_run_motion(session, calibration) if step.moves else calibration)
    if result is None:
        output.print_note("calibrate.ended", option=step.option)
        return ExitCode.INTERRUPTED
    with output.continue_without_output():  # the motor has moved, and the result is stored
        if result.outcome is not None:
            print_outcome(result.outcome, session.bus.now(), event="jogged", stream=True)
        return _print_result(session, step, result)


async def _run_motion(session: CalibrationSession, step: Awaitable[T]) -> T | None:
    """Run a step that moves the motor; stop the drive if it ends early. None: the user ended it."""
    try:
        result = await session.shutdown.interruptible(step)
    except BaseException as error:
        if must_stop_after(error):
            await _stop(session)
        raise
    if result is None:
        await _stop(session)
    return result


async def _stop(session: CalibrationSession) -> None:
    """Stop the drive and print how that ended. Raises StopUnconfirmed."""
    outcome = await session.drive.stop()
    with output.continue_without_output():
        print_outcome(outcome, session.bus.now(), event="stopped", stream=True)


def _print_result(session: CalibrationSession, step: CalibrationStep, result: CalibrationResult) -> ExitCode:
    """Print what is still open, or the options that were determined and whether they are stored."""
    from drivebus.drives.drive import VOLATILE_SCHEMES

    words = [f"{word:04X}H" for word in result.words]
    if not result.options:
        output.print_json(
            {"event": "open", "option": step.option, "left": result.candidates, "words": words}, stream=True
        )
        if step.observation_question is not None:
            output.print_message("calibrate.unseen")
        else:
            codings, shown = output.join(result.candidates, "items"), output.join(words, "items")
            output.print_message("calibrate.open", option=step.option, codings=codings, words=shown)
        return ExitCode.FAILED
    stored = session.bus.port.url.partition(":")[0] not in VOLATILE_SCHEMES
    output.print_json({"event": "calibrated", "options": result.options, "stored": stored, "words": words}, stream=True)
    for name, value in result.options.items():
        output.print_message("calibrate.result", option=name, value=str(value).lower())
    output.print_message("calibrate.stored" if stored else "calibrate.not_stored")
    return ExitCode.DONE


def _plan(dry: DryRun) -> ExitCode:
    from drivebus.drives.dialects.base import StopMode
    from drivebus.drives.operations.calibration import calibration_steps

    open_steps = [step for step in calibration_steps(dry.dialect) if step.is_open(dry.dialect.options)]
    planned = [part for step in open_steps for part in step.plan(dry.dialect)]
    if any(step.moves for step in open_steps):
        dry.add_readiness()
        dry.add_start_preparation()
    for purpose, requests in dict.fromkeys(planned):
        dry.add(purpose, requests)
    if planned:
        dry.add("stop", dry.dialect.stop(StopMode.STOP))
    return dry.print("dry.note.fewer", "dry.note.confirm")


def _run(*, dry_run: bool, **arguments: Any) -> ExitCode:
    target = pop_target(arguments)
    if dry_run:
        from drivebus.cli.dry_run import DryRun

        return _plan(DryRun(target))
    with background_output():
        return asyncio.run(_calibrate(target))


command = CliCommand(
    "calibrate",
    callback=_run,
    params=[*options.drive_options(), options.dry_run_option()],
    examples=(
        "drivebus calibrate /dev/ttyUSB0 --model dzb100 --address 1",
        "drivebus calibrate /dev/ttyUSB0 --model df800 --address 2",
        "drivebus calibrate /dev/ttyUSB0 --model df800 --address 2 --dry-run",
    ),
)
