"""``models``: what drivebus knows, with its grade; then the user's own files, and which of them are refused."""

from __future__ import annotations

import sys
from typing import Any

from drivebus.cli import output
from drivebus.cli.click_ext import CliCommand
from drivebus.cli.errors import ExitCode, error_json, print_error
from drivebus.cli.text_layout import paragraphs


def _models() -> ExitCode:
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
    code = ExitCode.USAGE if refused else ExitCode.DONE
    output.print_json({"models": found, "refused": [error_json(one)["error"] for one in refused], "exit": int(code)})
    output.print_text(_table(found))
    output.print_text(paragraphs(output.text("models.grades"), min(98, output.terminal_width(sys.stdout)), indent=0))
    for one in refused:
        print_error(one)
    return code


def _row(name: str, profile: Any) -> dict[str, Any]:
    """``name`` is what ``--model`` takes: a user's own file may keep its base's name within."""
    return {
        "model": name,
        "title": output.to_json_value(profile.title),
        "maker": output.to_json_value(profile.maker),
        "family": profile.family,
        "encodings": list(profile.encodings),
        "line": {"baud": profile.serial.baud, "format": profile.serial.format},
        "addresses": list(profile.addresses),
        "broadcast": profile.broadcast,
        "grade": profile.grade,
        "capabilities": sorted(profile.capabilities),
    }


def _table(found: list[dict[str, Any]]) -> str:
    head = [output.text(f"models.{name}") for name in ("model", "title", "encodings", "line", "grade")]
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
    return output.fitted_table(head, rows)


command = CliCommand("models", callback=_models, examples=("drivebus models", "drivebus models --json"))
