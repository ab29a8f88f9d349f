"""Text and JSON of readings, drive states, outcomes and frames."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from drivebus.cli import output
from drivebus.cli.errors import ExitCode, error_hint, error_text
from drivebus.errors import DrivebusError
from drivebus.types import Json
from drivebus.values import Quality, Reading

if TYPE_CHECKING:
    from drivebus.drives.dialects.base import Identity
    from drivebus.drives.outcome import FrameExchange, Outcome
    from drivebus.drives.state import DriveStatus, Fault
    from drivebus.profiles.model import DriveProfile, Parameter, Signal

MISSING_VALUE = "–"


# --- readings -----------------------------------------------------------------------------------------------------


def format_value(value: float | int | str | None, unit: str = "", entry: Signal | Parameter | None = None) -> str:
    """Format ``25.00 Hz`` with the decimals of the profile ``entry``; an absent value is a dash, never 0."""
    if value is None:
        return MISSING_VALUE
    return f"{value if isinstance(value, str) else _format_number(value, entry)} {unit}".rstrip()


def _format_number(value: float, entry: Signal | Parameter | None) -> str:
    decimals = entry.scale.decimals if entry is not None else 0
    if entry is not None and entry.scale.coding == "bcd" and not (decimals or entry.unit):
        return f"{value:04.0f}"  # a digit code, as on the keypad
    rounded = f"{value:.{decimals}f}"
    return rounded if abs(float(rounded) - value) < 1e-9 else f"{value:g}"


def format_reading(reading: Reading, entry: Signal | Parameter | None = None) -> str:
    """Format the value; a word without a unit (terminals, fault bits) also in hexadecimal."""
    shown = format_value(reading.value, reading.unit, entry)
    is_word = reading.raw is not None and reading.value is not None and not reading.unit
    return f"{shown} ({reading.raw:04X}H)" if is_word else shown


def reading_json(reading: Reading, now: float) -> Json:
    """Return ``{value, unit, quality, age_s}``, and the reason of an absent or uncertain value."""
    document: Json = {
        "value": reading.value,
        "unit": reading.unit,
        "quality": str(reading.quality),
        "age_s": round_or_none(reading.age_s(now)),
    }
    return document | ({"reason": output.text(reading.reason)} if reading.reason else {})


def round_or_none(value: float | None, decimals: int = 3) -> float | None:
    return None if value is None else round(value, decimals)


# --- status -------------------------------------------------------------------------------------------------------


def status_json(status: DriveStatus, now: float) -> Json:
    """Return state, direction, fault and readings."""
    fault = status.fault
    return {
        "state": str(status.state),
        "reason": reason_text(status),
        "direction": str(status.direction) if status.direction else None,
        "fault": None
        if fault is None
        else {
            "code": fault.code,
            "label": fault.label,
            "text": output.to_json_value(fault.text),
            "cause": output.to_json_value(fault.cause) if fault.cause else None,
            "remedy": output.to_json_value(fault.remedy) if fault.remedy else None,
        },
        "readings": {name: reading_json(reading, now) for name, reading in status.readings.items()},
    }


def status_text(status: DriveStatus, now: float, profile: DriveProfile, identity: Identity | None = None) -> str:
    """Format the page of a drive: state, fault, identity, readings with their age."""
    rows = [(output.text("status.state"), state_text(status))]
    unusable_reply = status.unusable_reply if status.reason else None
    if isinstance(unusable_reply, DrivebusError) and (hint := error_hint(unusable_reply)):
        rows.append((output.text("status.remedy"), hint))
    if status.fault is not None:
        from drivebus.drives.state import join_fault_after_word

        name = join_fault_after_word(status.fault.label, str(output.to_json_value(status.fault.text)))
        rows.append((output.text("status.fault"), name))
        for name in ("cause", "remedy"):
            text = getattr(status.fault, name)
            rows += [(output.text(f"status.{name}"), output.to_json_value(text))] if text else []
    if warning := warning_text(status):
        rows.append((output.text("status.warning"), warning))
    if identity is not None:
        rows.append((output.text("status.identity"), identity_text(identity)))
    page = [output.two_columns(rows, output.page_cells(), indent=0)]
    readings = [_reading_row(name, reading, now, profile) for name, reading in status.readings.items()]
    if readings:
        columns = ["reading", "meaning", "value", "age", "quality"]
        if output.language() == "en":  # the names are English: their meaning is shown in other languages
            columns.remove("meaning")
        head = [output.text(f"status.{name}") for name in columns]
        page.append(output.fitted_table(head, [[row[name] for name in columns] for row in readings]))
    return "\n\n".join(page)


def fault_text(fault: Fault) -> str:
    """Format the label of the keypad and the text of a fault."""
    return str(output.to_json_value(fault.name))


def identity_text(identity: Identity) -> str:
    """Format what a drive reports about itself: model, rating, its digits, and whether the host controls it."""
    parts = [" / ".join(identity.models)] if identity.models else []
    if identity.voltage_class_v is not None:
        parts.append(f"{identity.voltage_class_v} V")
    if identity.power_kw is not None:
        parts.append(f"{identity.power_kw:g} kW")
    parts += [f"{output.text(f'status.identity_{part}')} {digits}" for part, digits in identity.digits]
    if identity.host_controls is not None:
        parts.append(output.text("status.run_by_host" if identity.host_controls else "status.run_by_other"))
    if identity.host_sets_frequency is not None:
        key = "status.frequency_by_host" if identity.host_sets_frequency else "status.frequency_by_other"
        parts.append(output.text(key))
    return output.join(parts, "phrases")


def warning_text(status: DriveStatus) -> str:
    """Format the bits of the drive's warning word; empty where none is set or reported."""
    word = status.readings.get("warning_word")
    if word is None or not word.raw or word.quality is Quality.BAD:
        return ""
    bits = output.join((str(bit) for bit in range(16) if word.raw >> bit & 1), "items")
    return output.text("status.warning_bits", bits=bits, word=f"{word.raw:04X}H")


def _reading_row(name: str, reading: Reading, now: float, profile: DriveProfile) -> dict[str, str]:
    age = reading.age_s(now)
    signal = profile.signals.get(name)
    reason = output.text(reading.reason) if reading.reason else _status_bits_text(name, reading, profile)
    is_good = reading.quality is Quality.GOOD
    return {
        "reading": name,
        "meaning": output.to_json_value(signal.text) if signal is not None else output.text(f"signal.{name}"),
        "value": format_reading(reading, signal),
        "age": MISSING_VALUE if age is None else f"{age:.2f} s",
        "quality": reason if is_good else output.text(f"status.{reading.quality}", why=reason),
    }


def _status_bits_text(name: str, reading: Reading, profile: DriveProfile) -> str:
    """Format the bits that are set in a status word of bits; empty for every other reading."""
    if name != "state" or reading.raw is None or profile.status is None:
        return ""
    names = [output.text(f"drives.bit_{bit}") for bit in profile.status.set_bits(reading.raw)]
    return output.text("status.bits", bits=output.join(names, "items")) if names else ""


def state_text(status: DriveStatus) -> str:
    """Format ``running, forward``; an unknown state with the reason."""
    words = output.text(f"live.state.{status.state}")
    if status.direction is not None:
        words = output.join([words, output.text(f"status.{status.direction}")], "phrases")
    return words + (output.text("status.because", why=reason) if (reason := reason_text(status)) else "")


def reason_text(status: DriveStatus) -> str | None:
    """Return why the state is unknown: what the drive sends in place of a reply, if it sends anything."""
    if status.reason and isinstance(status.unusable_reply, DrivebusError):
        return error_text(status.unusable_reply)
    return output.text(status.reason) if status.reason else None


def status_line(status: DriveStatus, profile: DriveProfile) -> str:
    """Format the one-line status of an attached run."""
    shown = []
    for name in ("set_frequency", "output_frequency", "output_current", "dc_bus_voltage"):
        reading = status.readings.get(name)
        if reading is not None and reading.value is not None:
            value = format_value(reading.value, reading.unit, profile.signals.get(name))
            shown.append(f"{output.text(f'status.short.{name}')} {value}")
    return " · ".join([state_text(status), *shown])


# --- outcomes -----------------------------------------------------------------------------------------------------


def outcome_exit_code(outcome: Outcome) -> ExitCode:
    """Return 0 for confirmed or acknowledged, 4 for unknown, 1 for refused or failed."""
    if outcome.succeeded:
        return ExitCode.DONE
    return ExitCode.UNKNOWN if outcome.status == "unknown" else ExitCode.FAILED


def outcome_json(outcome: Outcome, now: float) -> Json:
    """Return an outcome with every frame of the command that shows it."""
    return {
        "outcome": str(outcome.status),
        "text": outcome.text(output.language()),
        "notes": outcome.note_texts(output.language()),
        "frames": [exchange_json(exchange) for exchange in outcome.exchanges],
        "status": status_json(outcome.drive_status, now) if outcome.drive_status else None,
    }


def exchange_json(exchange: FrameExchange) -> Json:
    """Return a frame and its reply; times are monotonic seconds."""
    return {
        "sent": exchange.sent,
        "received": exchange.received,
        "sent_at_s": exchange.sent_at,
        "received_at_s": exchange.received_at,
        "error": exchange.error,
    }


def outcome_text(outcome: Outcome) -> str:
    """Format the outcome of a command that succeeded, and its notes; any other outcome is raised as an error."""
    text = outcome.text(output.language())
    notes = [note for note in outcome.note_texts(output.language()) if note != text]
    result = output.wrap_for(output.text(f"outcome.{outcome.status}", text=text), sys.stdout)
    return "\n".join([result, *(output.wrap_for(note, sys.stdout, indent=2) for note in notes)])
