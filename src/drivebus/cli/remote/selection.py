"""Commands to a selection of drives of a service: one request, a result for each drive, equal refusals in one line."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from drivebus.cli import output
from drivebus.cli.errors import ExitCode
from drivebus.types import Json
from drivebus.values import Text

if TYPE_CHECKING:
    from drivebus.errors import DrivebusError
    from drivebus.service.api.operations import Operation


def call_on_selection(
    service: str, operation: Operation, drives: Iterable[str], group: str | None, *, everything: bool, **params: Any
) -> Json:
    """Execute an operation on drives; return the outcome or error of each. Raises ConfigurationError for no drive."""
    from drivebus.cli.remote.client import call_once
    from drivebus.errors import ConfigurationError

    selection: Json = {"drives": list(drives), "group": group, "all": everything}
    if not any(selection.values()):
        raise ConfigurationError("release.which")
    results: Json = call_once(service, operation.name, selection | params)["outcomes"]
    return results


def print_results(outcomes: Mapping[str, Json], *, json_key: str, done: str, nothing: str) -> ExitCode:
    """Print what was done and what was refused; ``done`` and ``nothing`` are keys of sentences.

    ``json_key``: key of a drive's id in the JSON output.
    """
    done_drives = [drive for drive, outcome in outcomes.items() if outcome.get("status") == "done"]
    refused = {drive: outcome for drive, outcome in outcomes.items() if "code" in outcome}
    with output.continue_without_output():  # it is done
        for drive in done_drives:
            output.print_json({json_key: drive}, stream=True)
        if done_drives:
            output.print_message(done, drive=output.join(done_drives, "items"))
        elif not refused:
            output.print_json({json_key: None}, stream=True)
            output.print_message(nothing)
        for drives, error in grouped_errors(refused):
            output.print_json({"refused": drives, "error": error.text("en"), "key": error.key}, stream=True)
            output.print_message("release.refused", why=error)
    return ExitCode.FAILED if refused else ExitCode.DONE


def grouped_errors(errors: Mapping[str, Json]) -> list[tuple[list[str], DrivebusError]]:
    """Return equal errors of several drives as one whose ``drive`` names them all."""
    from drivebus.service.api.errors import error_from_json

    groups: dict[str, tuple[list[str], DrivebusError]] = {}
    for drive, data in errors.items():
        error = error_from_json(data)
        alike = repr((error.key, sorted((k, v) for k, v in data["params"].items() if k != "drive")))
        groups.setdefault(alike, ([], error))[0].append(drive)
    for drives, error in groups.values():
        if "drive" in error.params:
            error.params = error.params | {"drive": Text.join_names(drives)}
    return list(groups.values())
