"""``models``: what drivebus knows, with its grade; then the user's own files, and which of them are refused."""

from __future__ import annotations

import sys
from typing import Any

from drivebus.cli import voice
from drivebus.cli.command import Verb
from drivebus.cli.exits import Exit, complain, describe
from drivebus.cli.layout import paragraphs


def _models() -> Exit:
    """A refused file hides no other; 2 where there is one."""
    from drivebus import profiles
    from drivebus.errors import ProfileError

    found: list[dict[str, Any]] = []
    refused: list[ProfileError] = []
    for name in dict.fromkeys(profiles.models()):
        try:
            found.append(_row(name, profiles.load(name)))
        except ProfileError as error:
            refused.append(error)
    code = Exit.USAGE if refused else Exit.DONE
    voice.document({"models": found, "refused": [describe(one)["error"] for one in refused], "exit": int(code)})
    voice.show(_table(found))
    voice.show(paragraphs(voice.say("models.grades"), min(98, voice.room(sys.stdout)), indent=0))
    for one in refused:
        complain(one)
    return code


def _row(name: str, profile: Any) -> dict[str, Any]:
    """``name`` is what ``--model`` takes: a user's own file may keep its base's name within."""
    return {
        "model": name,
        "title": voice.plain(profile.title),
        "maker": voice.plain(profile.maker),
        "family": profile.family,
        "encodings": list(profile.encodings),
        "line": {"baud": profile.line.baud, "format": profile.line.format},
        "addresses": list(profile.addresses),
        "broadcast": profile.broadcast,
        "grade": profile.grade,
        "capabilities": sorted(profile.capabilities),
    }


def _table(found: list[dict[str, Any]]) -> str:
    head = [voice.say(f"models.{name}") for name in ("model", "title", "encodings", "line", "grade")]
    rows = [
        [
            row["model"],
            row["title"],
            ", ".join(row["encodings"]),
            f"{row['line']['baud']} {row['line']['format']}",
            row["grade"],
        ]
        for row in found
    ]
    return voice.grid(head, rows)


command = Verb("models", callback=_models, examples=("drivebus models", "drivebus models --json"))
