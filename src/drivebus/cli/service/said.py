"""What a service says, as the library's own values: readings, states, outcomes."""

from __future__ import annotations

from typing import Any

from drivebus.drives.state import Direction, DriveState, DriveStatus, Exchange, Fault, Outcome, OutcomeWord
from drivebus.profiles.model import Text
from drivebus.reading import Quality, Reading

Json = dict[str, Any]

TOLD = "service.told"
"""The service's own sentence, in both languages."""


def text_of(found: Json | None) -> Text | None:
    return None if found is None else Text(found["en"], found["zh"])


def outcome_of(found: Json) -> Outcome:
    """The ``outcome`` of an answer, sentence and frames as the service tells them."""
    told = found["outcome"]
    notes = tuple((TOLD, {"text": text_of(note["text"])}) for note in told["notes"])
    frames = tuple(_exchange(frame) for frame in told["frames"])
    return Outcome(OutcomeWord(told["word"]), TOLD, {"text": text_of(told["text"])}, frames, None, notes)


def _exchange(frame: Json) -> Exchange:
    sent, received = bytes.fromhex(frame["sent"]), bytes.fromhex(frame["received"])
    return Exchange(sent, received, frame["sent_at_s"], frame["received_at_s"], frame["error"], frame["params"])


def status_of(view: Json, now: float) -> DriveStatus:
    """A DriveView. A drive that is silent has no state, whatever it was before."""
    readings = {name: reading_of(signal, now) for name, signal in view["signals"].items()}
    direction = None if view["direction"] is None else Direction(view["direction"])
    fault = view["fault"] and fault_of(view["fault"])
    return DriveStatus(DriveState(view["state"]), direction, fault, readings, view["state_reason"])


def reading_of(found: Json, now: float) -> Reading:
    """A value as old as the service says."""
    age_s = found.get("age_s")
    at = None if age_s is None else now - age_s
    return Reading(found["value"], found["unit"], Quality(found["quality"]), at, found["reason"], found.get("raw"))


def fault_of(found: Json) -> Fault:
    text = text_of(found["text"]) or Text("", "")
    return Fault(found["code"], found["label"], text, text_of(found.get("cause")), text_of(found.get("remedy")))
