"""``models``: what drivebus knows, with its grade."""

from __future__ import annotations

import sys
from typing import Any

from drivebus.cli import voice
from drivebus.cli.command import Verb
from drivebus.cli.layout import paragraphs


def _models() -> None:
    from drivebus import profiles

    found = [_row(profiles.load(name)) for name in profiles.models()]
    voice.document({"models": found})
    voice.show(_table(found))
    voice.show(paragraphs(voice.say("models.grades"), min(98, voice.room(sys.stdout)), indent=0))


def _row(profile: Any) -> dict[str, Any]:
    return {
        "model": profile.model,
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
