"""Outcomes, statuses and frames, for people and for programs. Text in, text out; sends nothing."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from drivebus.cli import output
from drivebus.cli.errors import ExitCode
from drivebus.cli.text_layout import two_columns
from drivebus.cli.tui.rows import status_json
from drivebus.cli.value_format import format_reading, format_value
from drivebus.values import Quality, Reading

if TYPE_CHECKING:
    from drivebus.drives.state import DriveStatus, FrameExchange, Outcome
    from drivebus.profiles.model import DriveProfile


def outcome_exit_code(outcome: Outcome) -> ExitCode:
    """0 confirmed or acknowledged, 4 unknown, 1 refused or failed."""
    if outcome.succeeded:
        return ExitCode.DONE
    return ExitCode.UNKNOWN if outcome.status == "unknown" else ExitCode.FAILED


def outcome_json(outcome: Outcome, now: float) -> dict[str, Any]:
    """An outcome with its evidence: every frame of the command, and when."""
    return {
        "outcome": str(outcome.status),
        "text": outcome.text(output.language()),
        "notes": [output.text(key, **params) for key, params in outcome.notes],
        "evidence": [exchange_json(one) for one in outcome.exchanges],
        "status": status_json(outcome.drive_status, now) if outcome.drive_status else None,
    }


def exchange_json(one: FrameExchange) -> dict[str, Any]:
    """One frame and its answer."""
    return {
        "sent": one.sent,
        "received": one.received,
        "sent_at": one.sent_at,
        "received_at": one.received_at,
        "error": one.error,
    }


def outcome_text(outcome: Outcome) -> str:
    """The outcome in words: what became of it, then what the user should know besides."""
    text = outcome.text(output.language())
    notes = [said for key, params in outcome.notes if (said := output.text(key, **params)) != text]
    told = output.wrap_for(output.text(f"outcome.{outcome.status}", text=text), sys.stdout)
    return "\n".join([told, *(output.wrap_for(note, sys.stdout, indent=2) for note in notes)])


def status_text(status: DriveStatus, now: float, profile: DriveProfile) -> str:
    """A drive's page: state, fault, readings with their age."""
    rows = [(output.text("status.state"), state_text(status))]
    if status.fault is not None:
        rows.append(
            (output.text("status.fault"), f"{status.fault.label} {output.to_json_value(status.fault.text)}".strip())
        )
        for name in ("cause", "remedy"):
            text = getattr(status.fault, name)
            rows += [(output.text(f"status.{name}"), output.to_json_value(text))] if text else []
    readings = [reading_row(name, reading, now, profile) for name, reading in status.readings.items()]
    head = [output.text(f"status.{name}") for name in ("reading", "meaning", "value", "age", "quality")]
    page = [two_columns(rows, min(98, output.terminal_width(sys.stdout)), indent=0)]
    return "\n\n".join([*page, output.fitted_table(*_drop_meaning_column(head, readings))] if readings else page)


def _drop_meaning_column(head: list[str], rows: list[list[str]]) -> tuple[list[str], list[list[str]]]:
    """Without the column that says what a name means, where the reader reads the names themselves."""
    if output.language() != "en":
        return head, rows
    return [head[0], *head[2:]], [[row[0], *row[2:]] for row in rows]


def state_text(status: DriveStatus) -> str:
    """``running, forward``; an unknown state with the reason."""
    words = output.text(f"live.state.{status.state}")
    if status.direction is not None:
        words += output.text("status.comma") + output.text(f"status.{status.direction}")
    return words + (output.text("status.because", why=output.text(status.reason)) if status.reason else "")


def reading_row(name: str, reading: Reading, now: float, profile: DriveProfile) -> list[str]:
    """One reading as a row: the name that ``read`` takes, what it means, value, age; without a value the reason."""
    age = reading.age_s(now)
    signal = profile.signals.get(name)
    meaning = output.to_json_value(signal.text) if signal is not None else output.text(f"signal.{name}")
    reason = output.text(reading.reason) if reading.reason else ""
    said = reason if reading.quality is Quality.GOOD else output.text(f"status.{reading.quality}", why=reason)
    return [name, meaning, format_reading(reading, signal), "–" if age is None else f"{age:.2f} s", said]


def status_line(status: DriveStatus, profile: DriveProfile) -> str:
    """One short line for an attached run."""
    shown = []
    for name in ("set_frequency", "output_frequency", "output_current", "dc_bus_voltage"):
        reading = status.readings.get(name)
        if reading is not None and reading.value is not None:
            value = format_value(reading.value, reading.unit, profile.signals.get(name))
            shown.append(f"{output.text(f'status.short.{name}')} {value}")
    return " · ".join([state_text(status), *shown])
