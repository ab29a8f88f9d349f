"""``profile``: write a profile from the facts of a manual (``new``), and check a profile file (``check``)."""

from __future__ import annotations

import click

from drivebus.cli import output
from drivebus.cli.click_ext import Argument, CliCommand, LazyGroup


def _check(file: str) -> None:
    from drivebus import profiles
    from drivebus.profiles import grades

    profile = profiles.load(file)
    lacks = [requirement.text(output.language()) for requirement in grades.open_requirements(profile)]
    counts = {"signals": len(profile.signals), "parameters": len(profile.parameters), "faults": len(profile.faults)}
    higher = grades.next_grade(profile)
    output.print_json(
        {"file": file, "valid": True, "model": profile.model, "grade": profile.grade}
        | counts
        | {"next_grade": higher, "lacks": lacks}
    )
    output.print_message("models.profile_good", file=file, model=profile.model, grade=profile.grade, **counts)
    if higher is not None:
        output.print_message("grades.next", grade=higher)
    for lack in lacks:
        output.print_wrapped(f"- {lack}", indent=2)


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
    sections={
        "cli.section.commands": {
            "new": "drivebus.cli.commands.profile_new:command",
            "check": "drivebus.cli.commands.profile:check",
        }
    },
    no_args_is_help=True,
    examples=("drivebus profile new my-drive.toml", "drivebus profile check my-drive.toml"),
)
