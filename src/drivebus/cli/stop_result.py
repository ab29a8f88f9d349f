"""Result of a stop of many drives: drives by the status of their stop, one sentence, exit code."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping

from drivebus.cli import output
from drivebus.cli.errors import ExitCode
from drivebus.types import Json

STATUSES = ("confirmed", "acknowledged", "unknown")  # in the order of the sentence


def drives_by_status(outcomes: Json) -> dict[str, list[str]]:
    """Return drive names by the status of their stop; an error in place of an outcome is an unknown one."""
    drives: dict[str, list[str]] = {status: [] for status in STATUSES}
    for name, outcome in outcomes.items():
        status = outcome.get("status")
        drives[status if status in drives else "unknown"].append(name)
    return drives


def result_text(drives: dict[str, list[str]], notes: Iterable[str] = ()) -> str:
    """Format the drives by the status of their stop, and further sentences."""
    parts = [
        output.text(f"bus_stop.{status}", addresses=output.join(names, "items"))
        for status, names in drives.items()
        if names
    ]
    return output.join([*(parts or [output.text("bus_stop.no_drives")]), *notes], "sentences")


def exit_code(drives: dict[str, list[str]]) -> ExitCode:
    """Return 0 where every stop is confirmed or acknowledged, 4 where one is not or where there is no drive."""
    return ExitCode.UNKNOWN if drives["unknown"] or not any(drives.values()) else ExitCode.DONE


def print_service_result(result: Json, service: str) -> ExitCode:
    """Print the answer of a service to a stop of all its drives; return the exit code.

    ``service``: its URL or socket, for the command that releases the starts.
    """
    durations_s = [bus["took_s"] for bus in result["buses"].values() if bus["took_s"] is not None]
    release = output.text("bus_stop.inhibited", service=shlex.quote(service))
    members = {"seconds": max(durations_s, default=None), "buses": result["buses"]}
    return print_outcomes(result["outcomes"], members, [release] if result["outcomes"] else [])


def print_outcomes(outcomes: Json, members: Json | None = None, notes: Iterable[str] = ()) -> ExitCode:
    """Print the outcome of the stop of each drive of a service; return the exit code.

    ``members``: further members of the JSON document. ``notes``: further sentences.
    """
    drives = drives_by_status(outcomes)
    text = result_text(drives, notes)
    output.print_json(
        {
            "confirmed": drives["confirmed"],
            "acknowledged": drives["acknowledged"],
            "unconfirmed": drives["unknown"],
            "text": text,
            **(members or {}),
            "drives": outcomes,
        }
    )
    output.print_wrapped(text)
    unknown = {name: outcomes[name].get("text") for name in drives["unknown"]}
    print_reasons({name: text[output.language()] for name, text in unknown.items() if text})
    return exit_code(drives)


def print_reasons(reasons: Mapping[str, str]) -> None:
    """Print why stops are not confirmed, each reason once with its drives. ``reasons``: by drive."""
    drives: dict[str, list[str]] = {}
    for name, reason in reasons.items():
        drives.setdefault(reason, []).append(name)
    for reason, names in drives.items():
        output.print_wrapped(f"{output.join(names, 'items')}: {reason}", indent=2)
