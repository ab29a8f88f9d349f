"""Outcomes, statuses and frames, for people and for programs. Text in, text out; sends nothing."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from drivebus.cli import voice
from drivebus.cli.exits import Exit
from drivebus.cli.figures import figure, word
from drivebus.cli.layout import two_columns
from drivebus.cli.live.model import status_document
from drivebus.reading import Quality, Reading

if TYPE_CHECKING:
    from drivebus.drives.state import DriveStatus, Exchange, Outcome
    from drivebus.profiles.model import DriveProfile


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
    """The outcome in words: what became of it, then what the user should know besides."""
    text = outcome.text(voice.language())
    notes = [said for key, params in outcome.notes if (said := voice.say(key, **params)) != text]
    told = voice.wrapped(voice.say(f"outcome.{outcome.word}", text=text), sys.stdout)
    return "\n".join([told, *(voice.wrapped(note, sys.stdout, indent=2) for note in notes)])


def status_lines(status: DriveStatus, now: float, profile: DriveProfile) -> str:
    """A drive's page: state, fault, readings with their age."""
    rows = [(voice.say("status.state"), state_words(status))]
    if status.fault is not None:
        rows.append((voice.say("status.fault"), f"{status.fault.label} {voice.plain(status.fault.text)}".strip()))
        for name in ("cause", "remedy"):
            text = getattr(status.fault, name)
            rows += [(voice.say(f"status.{name}"), voice.plain(text))] if text else []
    readings = [reading_row(name, reading, now, profile) for name, reading in status.readings.items()]
    head = [voice.say(f"status.{name}") for name in ("reading", "meaning", "value", "age", "quality")]
    page = [two_columns(rows, min(98, voice.room(sys.stdout)), indent=0)]
    return "\n\n".join([*page, voice.grid(*_in_english(head, readings))] if readings else page)


def _in_english(head: list[str], rows: list[list[str]]) -> tuple[list[str], list[list[str]]]:
    """Without the column that says what a name means, where the reader reads the names themselves."""
    if voice.language() != "en":
        return head, rows
    return [head[0], *head[2:]], [[row[0], *row[2:]] for row in rows]


def state_words(status: DriveStatus) -> str:
    """``running, forward``; an unknown state with the reason."""
    words = voice.say(f"live.state.{status.state}")
    if status.direction is not None:
        words += voice.say("status.comma") + voice.say(f"status.{status.direction}")
    return words + (voice.say("status.because", why=voice.say(status.reason)) if status.reason else "")


def reading_row(name: str, reading: Reading, now: float, profile: DriveProfile) -> list[str]:
    """One reading as a row: the name that ``read`` takes, what it means, value, age; without a value the reason."""
    age = reading.age_s(now)
    signal = profile.signals.get(name)
    meaning = voice.plain(signal.text) if signal is not None else voice.say(f"signal.{name}")
    reason = voice.say(reading.reason) if reading.reason else ""
    said = reason if reading.quality is Quality.GOOD else voice.say(f"status.{reading.quality}", why=reason)
    return [name, meaning, word(reading, signal), "–" if age is None else f"{age:.2f} s", said]


def status_line(status: DriveStatus, profile: DriveProfile) -> str:
    """One short line for an attached run."""
    shown = []
    for name in ("set_frequency", "output_frequency", "output_current", "dc_bus_voltage"):
        reading = status.readings.get(name)
        if reading is not None and reading.value is not None:
            value = figure(reading.value, reading.unit, profile.signals.get(name))
            shown.append(f"{voice.say(f'status.short.{name}')} {value}")
    return " · ".join([state_words(status), *shown])
