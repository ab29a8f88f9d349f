"""``bus-stop --service``: every drive on every bus of a plant, and who did not confirm it."""

from __future__ import annotations

import sys
from typing import Any

from drivebus.cli import output
from drivebus.cli.errors import ExitCode
from drivebus.cli.remote.client import call_once
from drivebus.errors import OutcomeUnknown, ServiceUnavailable

Json = dict[str, Any]


def stop_all_remote(service: str) -> ExitCode:
    """The same words and exit codes as on a line of one's own, with the drives' names for their addresses."""
    try:
        found = call_once(service, "plant.stop", {})
    except ServiceUnavailable as error:
        raise OutcomeUnknown("service.not_stopped", drive=service, why=error) from error
    words = drives_by_status(found["outcomes"])
    said = [output.text(f"bus_stop.{word}", addresses=", ".join(names)) for word, names in words.items() if names]
    took_s = [bus["took_s"] for bus in found["buses"].values() if bus["took_s"] is not None]
    output.print_json(
        {
            "confirmed": words["confirmed"],
            "acknowledged": words["acknowledged"],
            "unconfirmed": words["unknown"],
            "text": output.join_sentences(said),
            "seconds": max(took_s, default=None),
            "buses": found["buses"],
            "drives": found["outcomes"],
        }
    )
    output.print_text(output.wrap_for(output.join_sentences(said), sys.stdout))
    return ExitCode.UNKNOWN if words["unknown"] or not found["outcomes"] else ExitCode.DONE


def drives_by_status(outcomes: Json) -> dict[str, list[str]]:
    """Drives by how their stop ended; an error in place of an outcome is no stop."""
    words: dict[str, list[str]] = {"confirmed": [], "acknowledged": [], "unknown": []}
    for name, outcome in outcomes.items():
        word = outcome.get("status")
        words[word if word in words else "unknown"].append(name)
    return words
