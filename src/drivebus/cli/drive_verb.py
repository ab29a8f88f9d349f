"""What the verbs that command one drive share: parameters, running, and telling the outcome."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Any

from drivebus.cli import connect, options, voice
from drivebus.cli.command import Verb
from drivebus.cli.connect import Target
from drivebus.cli.exits import Exit
from drivebus.cli.service import option
from drivebus.cli.service.option import ServedVerb

if TYPE_CHECKING:
    import click

    from drivebus.cli.dry import DryRun
    from drivebus.drives import Drive, DriveLimits
    from drivebus.drives.state import Outcome


_OWN = ("link", "model", "address", "baud", "format", "encoding", "set", "record")


def target_of(given: dict[str, Any]) -> Target:
    """Take the options of ``options.drive()`` out of a verb's parameters."""
    return Target(**{name: given.pop(name) for name in _OWN})


def drive_verb(
    name: str,
    do: Callable[..., Awaitable[Exit]],
    plan: Callable[..., Exit],
    *,
    extra: tuple[click.Parameter, ...] = (),
    examples: tuple[str, ...],
) -> Verb:
    """A verb on one drive: ``do(target, **extra)`` does it, ``plan(dry, **extra)`` says what it would send."""

    def run(**given: Any) -> Exit:
        served = option.target_of(given, _OWN)
        dry_run = given.pop("dry_run")
        target = served or target_of(given)
        if dry_run:
            from drivebus.cli.dry import DryRun

            return plan(DryRun(target), **given)
        return asyncio.run(do(target, **given))  # type: ignore[arg-type]

    first, *rest = options.drive()
    params = [first, *[one for one in extra if one.param_type_name == "argument"], *rest]
    params += [one for one in extra if one.param_type_name != "argument"]
    params += [*option.service_drive(), options.dry_run()]
    return ServedVerb(name, callback=run, params=params, examples=examples)


async def command(target: Target, do: Callable[[Drive], Awaitable[Outcome]], limits: DriveLimits | None = None) -> Exit:
    """One command to one drive; its outcome decides the exit code."""
    async with connect.drive(target, limits) as (bus, drive):
        return tell(await do(drive), bus.now())


def tell(outcome: Outcome, now: float, *, stream: bool = False, **more: Any) -> Exit:
    """Print an outcome; ``more`` joins its JSON."""
    from drivebus.cli.outcome import exit_of, outcome_document, outcome_lines

    voice.document(more | outcome_document(outcome, now), stream=stream)
    voice.show(outcome_lines(outcome))
    return exit_of(outcome)


def simple(purpose: str, requests: Callable[[DryRun], Any], *notes: str) -> Callable[..., Exit]:
    """A plan of one step."""

    def plan(dry: DryRun, **_: Any) -> Exit:
        dry.add(purpose, requests(dry))
        return dry.show(*notes)

    return plan
