"""``models``: list the models with their grade, the user's own profile files, and rejected files."""

from __future__ import annotations

from typing import Any

from drivebus.cli import output
from drivebus.cli.click_ext import CliCommand, Option
from drivebus.cli.errors import ExitCode, error_json, print_error
from drivebus.cli.output import paragraphs


def _models(search: str) -> ExitCode:
    """List all models, or those that ``search`` names; return 2 if a file is rejected."""
    from drivebus.errors import ProfileError
    from drivebus.profiles.listing import list_models, matches_search

    all_models = list(list_models())
    refused = [summary for summary in all_models if isinstance(summary, ProfileError)]
    rows = [
        _row(summary)
        for summary in all_models
        if not isinstance(summary, ProfileError) and matches_search(summary, search)
    ]
    code = ExitCode.USAGE if refused else ExitCode.DONE
    output.print_json({"models": rows, "refused": [error_json(error)["error"] for error in refused], "exit": int(code)})
    if rows:
        output.print_text(_table(rows))
    note = output.text("models.grades") if rows else output.text("models.none", search=search)
    output.print_text(paragraphs(note, output.page_cells(), indent=0))
    for error in refused:
        print_error(error)
    return code


def _row(summary: dict[str, Any]) -> dict[str, Any]:
    """Return a model with its texts in the user's language."""
    return summary | {name: output.to_json_value(summary[name]) for name in ("title", "maker")}


def _table(models: list[dict[str, Any]]) -> str:
    head = [output.text(f"models.{name}") for name in ("model", "maker", "title", "encodings", "line", "grade")]
    rows = [
        [
            row["model"],
            row["maker"],
            row["title"],
            output.join(row["encodings"], "items"),
            f"{row['serial']['baud']} {row['serial']['format']}",
            row["grade"],
        ]
        for row in models
    ]
    return output.fitted_table(head, rows)


command = CliCommand(
    "models",
    callback=_models,
    params=[Option(["--search"], key="help.models.search", metavar="TEXT", default="", example="--search invt")],
    examples=("drivebus models", "drivebus models --search 英威腾", "drivebus models --json"),
)
