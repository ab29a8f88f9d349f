"""``bus-stop --service``: every drive on every bus of a plant, and who did not confirm it."""

from __future__ import annotations

import sys
from typing import Any

from drivebus.cli import voice
from drivebus.cli.exits import Exit
from drivebus.cli.service.client import ask
from drivebus.errors import OutcomeUnknown, ServiceUnavailable

Json = dict[str, Any]


def stop_everything(service: str) -> Exit:
    """The same words and exit codes as on a line of one's own, with the drives' names for their addresses."""
    try:
        found = ask(service, "plant.stop", {})
    except ServiceUnavailable as error:
        raise OutcomeUnknown("service.not_stopped", drive=service, why=error) from error
    words = by_word(found["outcomes"])
    said = [voice.say(f"bus_stop.{word}", addresses=", ".join(names)) for word, names in words.items() if names]
    took_s = [bus["took_s"] for bus in found["buses"].values() if bus["took_s"] is not None]
    voice.document(
        {
            "confirmed": words["confirmed"],
            "acknowledged": words["acknowledged"],
            "unconfirmed": words["unknown"],
            "text": voice.sentences(said),
            "seconds": max(took_s, default=None),
            "buses": found["buses"],
            "drives": found["outcomes"],
        }
    )
    voice.show(voice.wrapped(voice.sentences(said), sys.stdout))
    return Exit.UNKNOWN if words["unknown"] or not found["outcomes"] else Exit.DONE


def by_word(outcomes: Json) -> dict[str, list[str]]:
    """Drives by how their stop ended; an error in place of an outcome is no stop."""
    words: dict[str, list[str]] = {"confirmed": [], "acknowledged": [], "unknown": []}
    for name, outcome in outcomes.items():
        word = outcome.get("word")
        words[word if word in words else "unknown"].append(name)
    return words
