"""``models``: list the models with their grade, the user's own profile files, and rejected files."""

from __future__ import annotations

import sys
from typing import Any

from drivebus.cli import output
from drivebus.cli.click_ext import CliCommand
from drivebus.cli.errors import ExitCode, error_json, print_error
from drivebus.cli.output import paragraphs


def _models() -> ExitCode:
    """List all models; return 2 if a file is rejected."""
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
    """Return a model; ``name`` is the value of ``--model``, the user's own file may contain the name of its base."""
    return {
        "model": name,
        "title": output.to_json_value(profile.title),
        "maker": output.to_json_value(profile.maker),
        "family": profile.family,
        "encodings": list(profile.encodings),
        "serial": {"baud": profile.serial.baud, "format": profile.serial.format},
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
            f"{row['serial']['baud']} {row['serial']['format']}",
            row["grade"],
        ]
        for row in found
    ]
    return output.fitted_table(head, rows)


command = CliCommand("models", callback=_models, examples=("drivebus models", "drivebus models --json"))
