"""What the live view shows, as values: a row a drive, a row a line. Nothing here asks, draws or prints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from drivebus.cli import output
from drivebus.cli.formatting import reading_json, round_or_none
from drivebus.values import Quality, Reading

COLUMN_SIGNALS = ("set_frequency", "output_frequency", "output_current", "output_voltage", "dc_bus_voltage")
"""The columns that every drive has; what a drive does not report stays empty, never 0."""

_COLUMN_DECIMALS = {"set_frequency": 2, "output_frequency": 2, "output_current": 1}


@dataclass(frozen=True, slots=True)
class DriveRow:
    """One drive at one moment."""

    key: str
    """Unique: line and address."""
    name: str
    line: str
    model: str
    address: int
    state: str = "unknown"
    direction: str | None = None
    fault_label: str = ""
    fault_text: str = ""
    readings: Mapping[str, Reading] = field(default_factory=dict)
    presence: str = "never_seen"
    at: float | None = None
    commanded_hz: float | None = None
    """What we told it last, shown with a star where the drive reports no set frequency."""

    def cell(self, signal: str) -> str:
        """The number as the drive's own display would show it; a dash where the drive does not report it."""
        reading = self.readings.get(signal)
        if reading is None or reading.value is None:
            ours = self.commanded_hz if signal == "set_frequency" else None
            return "–" if ours is None else f"{ours:.2f}*"
        value = reading.value
        text = f"{value:.{_COLUMN_DECIMALS.get(signal, 0)}f}" if isinstance(value, int | float) else str(value)
        return text if reading.quality is Quality.GOOD else f"{text}?"

    def state_text(self) -> str:
        """Words for the state; a drive that does not answer is named so."""
        if self.presence != "online":
            return output.text(f"live.presence.{self.presence}")
        return output.text(f"live.state.{self.state}")

    def direction_text(self) -> str:
        return output.text(f"live.direction.{self.direction}") if self.direction else ""

    def age_s(self, now: float) -> float | None:
        """Age of the oldest value shown."""
        return None if self.at is None else max(0.0, now - self.at)

    def age_text(self, now: float) -> str:
        age = self.age_s(now)
        return "–" if age is None else f"{age:.1f}" if age < 100 else f"{age:.0f}"

    def to_json(self, now: float) -> dict[str, Any]:
        """The JSON of a row."""
        return {
            "drive": self.name,
            "line": self.line,
            "model": self.model,
            "address": self.address,
            "presence": self.presence,
            "state": self.state,
            "direction": self.direction,
            "fault": {"label": self.fault_label, "text": self.fault_text} if self.fault_label else None,
            "readings": {name: reading_json(reading, now) for name, reading in self.readings.items()},
            "commanded_hz": self.commanded_hz,
            "age_s": round_or_none(self.age_s(now)),
        }


@dataclass(frozen=True, slots=True)
class BusRow:
    """One line at one moment."""

    name: str
    settings: str
    up: bool = True
    load: float | None = None
    """Share of the time that the wire is busy, 0 to 1."""
    transactions_per_s: float | None = None
    errors: Mapping[str, int] = field(default_factory=dict)
    """Counters by kind."""

    def errors_text(self) -> str:
        """The counters that are not zero."""
        said = [f"{error_kind_text(kind)} {count}" for kind, count in self.errors.items() if count]
        return ", ".join(said) or output.text("live.no_errors")

    def to_json(self) -> dict[str, Any]:
        return {
            "line": self.name,
            "settings": self.settings,
            "up": self.up,
            "load": round_or_none(self.load, 4),
            "transactions_per_s": round_or_none(self.transactions_per_s, 2),
            "errors": dict(self.errors),
        }


def error_kind_text(kind: str) -> str:
    """An error class in the user's language; its own name where the catalogue lacks it."""
    key = f"live.error.{kind}"
    said = output.text(key)
    return kind if said == key else said
