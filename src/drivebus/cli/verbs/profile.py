"""``profile check FILE``: is this profile file one that drivebus believes?"""

from __future__ import annotations

import click

from drivebus.cli import voice
from drivebus.cli.command import Argument, LazyGroup, Verb


def _check(file: str) -> None:
    from drivebus import profiles

    profile = profiles.load(file)
    counts = {"signals": len(profile.signals), "parameters": len(profile.parameters), "faults": len(profile.faults)}
    voice.document({"file": file, "valid": True, "model": profile.model, "grade": profile.grade} | counts)
    voice.tell("models.profile_good", file=file, model=profile.model, grade=profile.grade, **counts)


check = Verb(
    "check",
    topic="profile.check",
    callback=_check,
    params=[Argument(["file"], metavar="FILE", type=click.Path())],
    examples=("drivebus profile check my-drive.toml", "drivebus profile check my-drive.toml --json"),
)

command = LazyGroup(
    "profile",
    topic="profile",
    sections={"cli.section.profile": {"check": "drivebus.cli.verbs.profile:check"}},
    no_args_is_help=True,
    examples=("drivebus profile check my-drive.toml",),
)
