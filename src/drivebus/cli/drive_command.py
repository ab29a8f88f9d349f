"""What the verbs that command one drive share: parameters, running, and telling the outcome."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Any

from drivebus.cli import connect, options, output
from drivebus.cli.click_ext import CliCommand
from drivebus.cli.connect import Target
from drivebus.cli.errors import ExitCode
from drivebus.cli.remote import options as remote_options
from drivebus.cli.remote.options import RemoteCommand

if TYPE_CHECKING:
    import click

    from drivebus.cli.dry_run import DryRun
    from drivebus.drives import Drive, DriveLimits
    from drivebus.drives.state import Outcome


_PORT_OPTIONS = ("link", "model", "address", "baud", "format", "encoding", "set", "record")


def pop_target(given: dict[str, Any]) -> Target:
    """Take the options of ``options.drive()`` out of a verb's parameters."""
    return Target(**{name: given.pop(name) for name in _PORT_OPTIONS})


def drive_command(
    name: str,
    do: Callable[..., Awaitable[ExitCode]],
    plan: Callable[..., ExitCode],
    *,
    extra: tuple[click.Parameter, ...] = (),
    examples: tuple[str, ...],
) -> CliCommand:
    """A verb on one drive: ``do(target, **extra)`` does it, ``plan(dry, **extra)`` says what it would send."""

    def run(**given: Any) -> ExitCode:
        served = remote_options.pop_remote_target(given, _PORT_OPTIONS)
        dry_run = given.pop("dry_run")
        target = served or pop_target(given)
        if dry_run:
            from drivebus.cli.dry_run import DryRun

            return plan(DryRun(target), **given)
        return asyncio.run(do(target, **given))  # type: ignore[arg-type]

    first, *rest = options.drive_options()
    params = [first, *[one for one in extra if one.param_type_name == "argument"], *rest]
    params += [one for one in extra if one.param_type_name != "argument"]
    params += [*remote_options.service_drive_options(), options.dry_run_option()]
    return RemoteCommand(name, callback=run, params=params, examples=examples)


async def run_command(
    target: Target, do: Callable[[Drive], Awaitable[Outcome]], limits: DriveLimits | None = None
) -> ExitCode:
    """One command to one drive; its outcome decides the exit code."""
    async with connect.open_drive(target, limits) as (bus, drive):
        return print_outcome(await do(drive), bus.now())


def print_outcome(outcome: Outcome, now: float, *, stream: bool = False, **more: Any) -> ExitCode:
    """Print an outcome; ``more`` joins its JSON."""
    from drivebus.cli.formatting import outcome_exit_code, outcome_json, outcome_text

    output.print_json(more | outcome_json(outcome, now), stream=stream)
    output.print_text(outcome_text(outcome))
    return outcome_exit_code(outcome)


def single_step_plan(purpose: str, requests: Callable[[DryRun], Any], *notes: str) -> Callable[..., ExitCode]:
    """A plan of one step."""

    def plan(dry: DryRun, **_: Any) -> ExitCode:
        dry.add(purpose, requests(dry))
        return dry.print(*notes)

    return plan
