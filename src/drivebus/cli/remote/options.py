"""``--service`` and ``--drive``: what they do to the other parameters of a verb."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

import click

from drivebus.cli.click_ext import CliCommand, Option
from drivebus.cli.connect import Target
from drivebus.errors import ConfigurationError

_SERVICE_GIVEN = "drivebus.service"
_REPLACED_ARGUMENTS = ("link", "source")
"""Arguments whose place ``--service`` takes."""


def service_option() -> list[click.Parameter]:
    """--service alone: for verbs about a whole line."""
    example = "--service http://127.0.0.1:8080"
    return [Option(["--service"], metavar="URL|SOCKET", example=example)]


def service_drive_options() -> list[click.Parameter]:
    """--service and --drive."""
    return [*service_option(), Option(["--drive"], metavar="NAME", example="--drive fan-1")]


class RemoteCommand(CliCommand):
    """A verb that needs no LINK where it is given a service."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        own = args[: args.index("--")] if "--" in args else args
        ctx.meta[_SERVICE_GIVEN] = any(word == "--service" or word.startswith("--service=") for word in own)
        return super().parse_args(ctx, args)

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        params = super().get_params(ctx)
        return (
            [_optional(one) for one in params if one.name not in _REPLACED_ARGUMENTS]
            if ctx.meta.get(_SERVICE_GIVEN)
            else params
        )


def _optional(param: click.Parameter) -> click.Parameter:
    """Not required: the service knows it."""
    if not (param.required and isinstance(param, click.Option)):
        return param
    free = copy.copy(param)
    free.required = False
    return free


def pop_remote_target(given: dict[str, Any], names: Sequence[str]) -> Target | None:
    """The drive of ``--service`` and ``--drive``, model and address as the service says; None without ``--service``.

    Takes both and ``names`` out of ``given``. Raises ConfigurationError where one of ``names`` (options that are about
    a line of one's own) or ``--dry-run`` was given too, or ``--drive`` is missing or has no service.
    """
    asked, drive = given.pop("service", None), given.pop("drive", None)
    if asked is None:
        if drive is not None:
            raise ConfigurationError("service.drive_alone")
        return None
    reject_local_options(given, names)
    if drive is None:
        raise ConfigurationError("service.no_drive")
    for name in names:
        given.pop(name, None)
    return _resolve_drive(asked, drive)


def reject_local_options(given: dict[str, Any], names: Sequence[str]) -> None:
    """Raises ConfigurationError for an option that says nothing to a service."""
    more = ("dry_run", "wait", "eeprom_writes_per_day")
    wrong = next((name for name in (*names, *more) if given.get(name) not in (None, False, ())), None)
    if wrong is not None:
        raise ConfigurationError("service.not_with", option=f"--{wrong.replace('_', '-')}")


def _resolve_drive(service: str, drive: str) -> Target:
    from drivebus.cli.remote.client import call_once

    view = call_once(service, "drives.get", {"drive": drive})
    return Target(service, view["model"], view["address"], service=service, drive=drive)
