"""Conversion of a service's JSON to the library's values: readings, states, outcomes."""

from __future__ import annotations

from drivebus.drives.operations.loopback import LoopbackReport
from drivebus.drives.outcome import FrameExchange, Outcome, OutcomeStatus
from drivebus.drives.state import Direction, DriveState, DriveStatus, Fault
from drivebus.errors import DrivebusError
from drivebus.service.api.errors import error_from_json
from drivebus.types import Json
from drivebus.values import Quality, Reading, Text

SERVICE_TEXT_KEY = "service.text"  # the sentence of the service, in both languages


def parse_text(data: Json | None) -> Text | None:
    return None if data is None else Text.from_mapping(data)


def parse_outcome(data: Json) -> Outcome:
    """Return the ``outcome`` of a response, with the sentences and frames of the service."""
    outcome = data["outcome"]
    notes = tuple((SERVICE_TEXT_KEY, {"text": parse_text(note["text"])}) for note in outcome["notes"])
    frames = tuple(_parse_exchange(frame) for frame in outcome["frames"])
    return Outcome(
        status=OutcomeStatus(outcome["status"]),
        key=SERVICE_TEXT_KEY,
        params={"text": parse_text(outcome["text"])},
        exchanges=frames,
        drive_status=None,
        notes=notes,
    )


def parse_error_outcome(error: DrivebusError) -> DrivebusError:
    """Return an error of the service with its outcome in place of the JSON of that.

    An outcome that can't be read, as of a service of another version, is an unknown one: the command was sent.
    """
    if error.outcome is not None:
        try:
            error.outcome = parse_outcome({"outcome": error.outcome})
        except (AttributeError, KeyError, TypeError, ValueError):
            error.outcome = Outcome(status=OutcomeStatus.UNKNOWN, key=error.key, params=error.params)
    return error


def _parse_exchange(frame: Json) -> FrameExchange:
    sent, received = bytes.fromhex(frame["sent"]), bytes.fromhex(frame["received"])
    return FrameExchange(
        sent=sent,
        received=received,
        sent_at=frame["sent_at_s"],
        received_at=frame["received_at_s"],
        error=frame["error"],
        params=frame["params"],
    )


def parse_loopback(data: Json) -> LoopbackReport:
    error = None if data["error"] is None else error_from_json(data["error"])
    round_trips_s = tuple(round_trip_ms / 1000 for round_trip_ms in data["round_trips_ms"])
    return LoopbackReport(data["requests"], round_trips_s, data["repetitions"], error)


def parse_status(view: Json, now: float) -> DriveStatus:
    """Return the status of a DriveView."""
    readings = {name: parse_reading(signal, view["time_ms"], now) for name, signal in view["signals"].items()}
    direction = None if view["direction"] is None else Direction(view["direction"])
    fault = view["fault"] and parse_fault(view["fault"])
    return DriveStatus(
        state=DriveState(view["state"]),
        direction=direction,
        fault=fault,
        readings=readings,
        reason=view["state_reason"],
        unusable_reply=error_from_json(view["unusable_reply"]) if view.get("unusable_reply") else None,
    )


def reading_time(time_ms: int | None, service_now_ms: int, now: float) -> float | None:
    """Return the local monotonic second of a time on the service's clock, which shows ``service_now_ms`` at ``now``."""
    return None if time_ms is None else now - (service_now_ms - time_ms) / 1000


def parse_reading(data: Json, service_now_ms: int = 0, now: float = 0.0) -> Reading:
    """Return a signal's value, as old as it is on the service's clock, or a parameter's value, which has no time."""
    at = reading_time(data.get("source_time_ms"), service_now_ms, now)
    return Reading(
        value=data["value"],
        unit=data["unit"],
        quality=Quality(data["quality"]),
        source_time=at,
        reason=data["reason"],
        raw=data.get("raw"),
    )


def parse_fault(data: Json) -> Fault:
    text = parse_text(data["text"]) or Text("", "")
    return Fault(data["code"], data["label"], text, parse_text(data.get("cause")), parse_text(data.get("remedy")))
