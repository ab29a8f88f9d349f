"""``profile check``: check a profile file."""

from __future__ import annotations

import click

from drivebus.cli import output
from drivebus.cli.click_ext import Argument, CliCommand, LazyGroup


def _check(file: str) -> None:
    from drivebus import profiles

    profile = profiles.load(file)
    counts = {"signals": len(profile.signals), "parameters": len(profile.parameters), "faults": len(profile.faults)}
    output.print_json({"file": file, "valid": True, "model": profile.model, "grade": profile.grade} | counts)
    output.print_message("models.profile_good", file=file, model=profile.model, grade=profile.grade, **counts)


check = CliCommand(
    "check",
    help_key="profile.check",
    callback=_check,
    params=[Argument(["file"], metavar="FILE", type=click.Path())],
    examples=("drivebus profile check my-drive.toml", "drivebus profile check my-drive.toml --json"),
)

command = LazyGroup(
    "profile",
    help_key="profile",
    sections={"cli.section.profile": {"check": "drivebus.cli.commands.profile:check"}},
    no_args_is_help=True,
    examples=("drivebus profile check my-drive.toml",),
)
