"""``drivebus acceptance``: the acceptance checklist on real hardware, and its dated report in JSON and text."""

from __future__ import annotations

import asyncio
import json
import sys
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from drivebus import clock
from drivebus.cli import connect, options, output
from drivebus.cli.background_output import background_output
from drivebus.cli.click_ext import CliCommand, Option
from drivebus.cli.connect import Target
from drivebus.cli.drive_command import pop_target, print_outcome
from drivebus.cli.errors import ExitCode, from_os_error, print_error
from drivebus.cli.tui.rows import error_kind_text
from drivebus.cli.written_file import check_writable, write_file
from drivebus.commissioning.acceptance import (
    ACCEPTANCE_STEPS,
    AcceptanceInterrupted,
    AcceptanceSession,
    StepFinding,
    StepResult,
    run_step,
)
from drivebus.errors import StopUnconfirmed
from drivebus.service.process.module_command import module_command
from drivebus.user_input import normalize_answer

if TYPE_CHECKING:
    from drivebus.bus import Bus
    from drivebus.cli.signals import ShutdownSignal
    from drivebus.drives import Drive

T = TypeVar("T")
ACCEPTANCE_FREQUENCY_HZ = 5.0


class TerminalAcceptance(AcceptanceSession):
    """Checklist on the target of the command line, with a person at the terminal."""

    def __init__(self, target: Target, shutdown: ShutdownSignal, *, motor: bool, frequency_hz: float) -> None:
        super().__init__(target.port, motor=motor, frequency_hz=frequency_hz)
        self._target, self._shutdown = target, shutdown

    @asynccontextmanager
    async def drive(self, serial_format: str | None = None) -> AsyncIterator[tuple[Bus, Drive]]:
        target = self._target if serial_format is None else replace(self._target, format=serial_format)
        async with connect.open_drive(target) as found:
            yield found

    async def second_instance(self) -> dict[str, Any]:
        target = self._target
        arguments = ["--model", target.model, "--address", str(target.address), "--json", "--lang", output.language()]
        arguments += [] if target.baud is None else ["--baud", str(target.baud)]
        arguments += [] if target.format is None else ["--format", target.format]
        program = await asyncio.create_subprocess_exec(
            *module_command("drivebus", "status", target.port, *arguments),
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.DEVNULL,
            process_group=0,  # suspended by Ctrl-Z, it would be waited for without end
        )
        printed, _ = await program.communicate()
        document: dict[str, Any] = json.loads(printed.splitlines()[-1])
        return document

    async def race(self, work: Awaitable[T]) -> T:
        found = await self._shutdown.interruptible(_boxed(work))
        if found is None:
            raise AcceptanceInterrupted
        return found[0]

    async def ask(self, key: str, /, **params: Any) -> str:
        if not sys.stdin.isatty():
            return ""
        output.print_note(key, **params)
        return normalize_answer(await self.race(_read_line())).strip()

    @contextmanager
    def progress(self, step: str) -> Iterator[Callable[[float, float], None]]:
        description = output.text(f"acceptance.step.{step}")
        with output.ProgressBar() as bar:
            yield lambda done_s, total_s: bar.update(description, done_s, total_s)


async def _boxed(work: Awaitable[T]) -> tuple[T]:
    return (await work,)


async def _read_line() -> str:
    """Read a line of standard input while the loop runs; a line that comes after a cancellation is discarded."""
    loop = asyncio.get_running_loop()
    ready: asyncio.Future[str] = loop.create_future()

    def readable() -> None:
        loop.remove_reader(sys.stdin)
        if not ready.done():
            ready.set_result(sys.stdin.readline())

    loop.add_reader(sys.stdin, readable)
    try:
        return await ready
    finally:
        loop.remove_reader(sys.stdin)


def _acceptance(*, motor: bool, frequency: float, folder: Path, **arguments: Any) -> ExitCode:
    folder.mkdir(parents=True, exist_ok=True)
    check_writable(folder / "report", replace=True)
    with background_output():
        return asyncio.run(_run(pop_target(arguments), folder, motor=motor, frequency_hz=frequency))


async def _run(target: Target, folder: Path, *, motor: bool, frequency_hz: float) -> ExitCode:
    from drivebus.cli.signals import shutdown_signals

    findings: list[StepFinding] = []
    report_error: OSError | None = None
    with shutdown_signals(may_suspend=not motor) as shutdown:
        session = TerminalAcceptance(target, shutdown, motor=motor, frequency_hz=frequency_hz)
        try:
            for name in ACCEPTANCE_STEPS:
                findings.append(await run_step(name, session))
                with output.continue_without_output():  # the report has it
                    output.print_json(_finding_json(findings[-1]), stream=True)
                    _print_finding(findings[-1])
        except AcceptanceInterrupted as interruption:
            with output.continue_without_output():
                if interruption.stop is not None:
                    print_outcome(interruption.stop, time.monotonic(), event="stopped", stream=True)
                output.print_note("cli.interrupted")
        finally:
            try:
                write_report(folder, target, findings)
            except OSError as error:  # it must not hide a stop that is not confirmed
                report_error = error
                with output.continue_without_output():
                    print_error(from_os_error(error))
    if any(isinstance(finding.figures.get("error"), StopUnconfirmed) for finding in findings):
        return ExitCode.UNKNOWN
    if shutdown.received:
        return ExitCode.INTERRUPTED
    failed = any(finding.verdict is StepResult.FAILED for finding in findings)
    return ExitCode.FAILED if failed else ExitCode.DONE if report_error is None else ExitCode.USAGE


def _print_finding(finding: StepFinding) -> None:
    first, *further = _finding_lines(finding)
    output.print_wrapped(first)
    for line in further:
        output.print_wrapped(line, indent=4)


def _finding_lines(finding: StepFinding) -> list[str]:
    """Return the step with its verdict, then its figures and the reason, where it has any."""
    figures = output.join((f"{name}={_figure_text(value)}" for name, value in _figures(finding).items()), "items")
    reason = output.text(finding.reason) if finding.reason else ""
    step = output.text(f"acceptance.step.{finding.step}")
    parts = [f"[{output.text(f'acceptance.{finding.verdict}')}] {step}", figures, reason]
    return [part for part in parts if part]


def _figure_text(value: Any) -> str:
    """Format the errors of a dict, counted by kind, as a list in the user's language, any other value as it is."""
    if not isinstance(value, dict):
        return str(value)
    return output.join((f"{error_kind_text(kind)} {count}" for kind, count in value.items()), "items") or "-"


def _figures(finding: StepFinding) -> dict[str, Any]:
    """Return the figures with errors as sentences."""
    texts = {name: getattr(value, "text", None) for name, value in finding.figures.items()}
    return {
        name: text(output.language()) if callable(text := texts[name]) else value
        for name, value in finding.figures.items()
    }


def _finding_json(finding: StepFinding) -> dict[str, Any]:
    return {
        "step": finding.step,
        "verdict": str(finding.verdict),
        "figures": _figures(finding),
        "reason": finding.reason and output.text(finding.reason),
    }


def write_report(folder: Path, target: Target, findings: list[StepFinding]) -> None:
    """Write ``drivebus-acceptance-<date>.json`` and ``.md``. Raises FileExistsError instead of replacing a report."""
    now = clock.wall_clock().astimezone()
    path = folder / f"drivebus-acceptance-{now:%Y%m%d-%H%M%S}"
    head = {
        "date": now.isoformat(timespec="seconds"),
        "drivebus": version("drivebus"),
        "port": target.port,
        "model": target.model,
        "address": target.address,
    }
    document = head | {"findings": [_finding_json(finding) for finding in findings]}
    text = (
        output.text("acceptance.title", **head)
        + "\n\n"
        + "\n".join("- " + "\n    ".join(_finding_lines(finding)) for finding in findings)
        + "\n"
    )
    for suffix, content in ((".json", json.dumps(document, indent=1, ensure_ascii=False) + "\n"), (".md", text)):
        write_file(path.with_suffix(suffix), content.encode(), replace=False)
    with output.continue_without_output():
        output.print_message("acceptance.written", path=path.with_suffix(".md"))


command = CliCommand(
    "acceptance",
    help_key="acceptance",
    callback=_acceptance,
    params=[
        *options.drive_options(),
        Option(["--motor"], is_flag=True, key="acceptance.option_motor"),
        Option(
            ["--frequency"],
            type=options.NumberType(0.5, 10.0),
            default=ACCEPTANCE_FREQUENCY_HZ,
            metavar="HZ",
            key="acceptance.option_frequency",
            example="--frequency 5",
        ),
        Option(
            ["--folder"],
            type=options.FOLDER,
            default=Path(),
            metavar="FOLDER",
            key="acceptance.option_folder",
            example="--folder reports",
        ),
    ],
    examples=(
        "drivebus acceptance /dev/ttyUSB0 --model vc660 --address 1",
        "drivebus acceptance /dev/ttyUSB0 --model c320 --address 1 --motor",
    ),
)
