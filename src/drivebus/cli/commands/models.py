"""``models``: list the models with their grade, the user's own profile files, and rejected files."""

from __future__ import annotations

import sys
from typing import Any

from drivebus.cli import output
from drivebus.cli.click_ext import CliCommand, Option
from drivebus.cli.errors import ExitCode, error_json, print_error
from drivebus.cli.output import paragraphs


def _models(search: str) -> ExitCode:
    """List all models, or those that ``search`` names; return 2 if a file is rejected."""
    from drivebus import profiles
    from drivebus.errors import ProfileError

    found: list[dict[str, Any]] = []
    refused: list[ProfileError] = []
    for name in dict.fromkeys(profiles.models()):
        try:
            profile = profiles.load(name)
            if _matches(name, profile, search):
                found.append(_row(name, profile))
        except ProfileError as error:
            refused.append(error)
    code = ExitCode.USAGE if refused else ExitCode.DONE
    output.print_json({"models": found, "refused": [error_json(one)["error"] for one in refused], "exit": int(code)})
    output.print_text(_table(found) if found else output.text("models.none", search=search))
    output.print_text(paragraphs(output.text("models.grades"), min(98, output.terminal_width(sys.stdout)), indent=0))
    for one in refused:
        print_error(one)
    return code


def _matches(name: str, profile: Any, search: str) -> bool:
    """Return whether model, maker and title, in either language, contain every word of a search."""
    texts = [name, *(text for both in (profile.maker, profile.title) for text in (both.en, both.zh))]
    joined = " ".join(texts).casefold()
    return all(word in joined for word in search.casefold().split())


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
    head = [output.text(f"models.{name}") for name in ("model", "maker", "title", "encodings", "line", "grade")]
    rows = [
        [
            row["model"],
            row["maker"],
            row["title"],
            ", ".join(row["encodings"]),
            f"{row['serial']['baud']} {row['serial']['format']}",
            row["grade"],
        ]
        for row in found
    ]
    return output.fitted_table(head, rows)


command = CliCommand(
    "models",
    callback=_models,
    params=[Option(["--search"], key="help.models.search", metavar="TEXT", default="", example="--search invt")],
    examples=("drivebus models", "drivebus models --search 英威腾", "drivebus models --json"),
)
