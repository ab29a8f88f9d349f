"""Outcomes, statuses and frames, for people and for programs. Text in, text out; sends nothing."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from drivebus.cli import voice
from drivebus.cli.exits import Exit
from drivebus.cli.layout import table, two_columns
from drivebus.cli.live.model import status_document
from drivebus.reading import Quality, Reading

if TYPE_CHECKING:
    from drivebus.drives.state import DriveStatus, Exchange, Outcome


def exit_of(outcome: Outcome) -> Exit:
    """0 confirmed or acknowledged, 4 unknown, 1 refused or failed."""
    if outcome.done:
        return Exit.DONE
    return Exit.UNKNOWN if outcome.word == "unknown" else Exit.REFUSED


def outcome_document(outcome: Outcome, now: float) -> dict[str, Any]:
    """An outcome with its evidence: every frame of the command, and when."""
    return {
        "outcome": str(outcome.word),
        "text": outcome.text(voice.language()),
        "notes": [voice.say(key, **params) for key, params in outcome.notes],
        "evidence": [exchange_document(one) for one in outcome.evidence],
        "status": status_document(outcome.status, now) if outcome.status else None,
    }


def exchange_document(one: Exchange) -> dict[str, Any]:
    """One frame and its answer."""
    return {
        "sent": one.sent,
        "received": one.received,
        "sent_at": one.sent_at,
        "received_at": one.received_at,
        "error": one.error,
    }


def outcome_lines(outcome: Outcome) -> str:
    """The outcome in words: what became of it, then what the user should know."""
    word = voice.say(f"outcome.{outcome.word}")
    notes = [voice.wrapped(voice.say(key, **params), sys.stdout, indent=2) for key, params in outcome.notes]
    return "\n".join([voice.wrapped(f"{word} {outcome.text(voice.language())}", sys.stdout), *notes])


def status_lines(status: DriveStatus, now: float) -> str:
    """A drive's page: state, fault, readings with their age."""
    rows = [(voice.say("status.state"), state_words(status))]
    if status.fault is not None:
        rows.append((voice.say("status.fault"), f"{status.fault.label} {voice.plain(status.fault.text)}".strip()))
        for name in ("cause", "remedy"):
            text = getattr(status.fault, name)
            rows += [(voice.say(f"status.{name}"), voice.plain(text))] if text else []
    readings = [reading_row(name, reading, now) for name, reading in status.readings.items()]
    head = [voice.say(f"status.{name}") for name in ("reading", "value", "age", "quality")]
    return "\n\n".join(
        [two_columns(rows, 98, indent=0), table(head, readings)] if readings else [two_columns(rows, 98, 0)]
    )


def state_words(status: DriveStatus) -> str:
    """``running, forward``; an unknown state with the reason."""
    words = voice.say(f"live.state.{status.state}")
    if status.direction is not None:
        words += ", " + voice.say(f"status.{status.direction}")
    return f"{words} ({voice.say(status.reason)})" if status.reason else words


def reading_row(name: str, reading: Reading, now: float) -> list[str]:
    """One reading as a row; where there is no value, the reason."""
    age = reading.age_s(now)
    value = "–" if reading.value is None else f"{reading.value} {reading.unit}".strip()
    said = "" if reading.quality is Quality.GOOD else voice.say(f"status.{reading.quality}")
    reason = voice.say(reading.reason) if reading.reason else ""
    return [name, value, "–" if age is None else f"{age:.2f} s", f"{said} {reason}".strip()]


def status_line(status: DriveStatus) -> str:
    """One short line for an attached run."""
    shown = []
    for name in ("set_frequency", "output_frequency", "output_current", "dc_bus_voltage"):
        reading = status.readings.get(name)
        if reading is not None and reading.value is not None:
            shown.append(f"{voice.say(f'status.short.{name}')} {reading.value:g} {reading.unit}")
    return " · ".join([state_words(status), *shown])
