"""Rows of the live view: values of one drive or one bus at one moment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from drivebus.cli import output
from drivebus.cli.formatting import reading_json, reason_text, round_or_none
from drivebus.drives.state import join_fault
from drivebus.values import Quality, Reading

if TYPE_CHECKING:
    from drivebus.drives.state import DriveStatus

COLUMN_SIGNALS = ("set_frequency", "output_frequency", "output_current", "output_voltage", "dc_bus_voltage")
"""Columns of every drive; a value that a drive does not report stays empty, never 0."""

ERROR_COUNTERS = frozenset(
    {"late", "foreign", "duplicate", "unsolicited", "foreign_request", "collision", "line_errors"}
)
"""Counters of a bus that are shown with its errors; ``echo`` and ``retry`` are none."""

_COLUMN_DECIMALS = {"set_frequency": 2, "output_frequency": 2, "output_current": 1}


_REASONS_OF_NO_READING = {"drives.not_read", "drives.no_answer", "drives.stale"}
_REASONS_OF_SILENCE = {*_REASONS_OF_NO_READING, "drives.port_lost", "drives.no_run_status"}
"""Reasons that the presence, the bus or the model shows already."""


def unknown_reason(status: DriveStatus, presence: str, duplicate_of: int | None = None) -> str | None:
    """Return why the state is unknown although the drive sends something; None for any other status.

    ``duplicate_of``: address whose replies come twice.
    """
    if status.unusable_reply is not None:
        return reason_text(status)
    if presence != "online":
        return None
    if duplicate_of is not None and status.reason in _REASONS_OF_NO_READING:
        return output.text("drives.duplicate", station=duplicate_of)
    return None if status.reason in _REASONS_OF_SILENCE else reason_text(status)


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveRow:
    """Values of one drive at one moment."""

    key: str
    """Name that is unique among the rows."""
    name: str
    bus: str
    model: str
    address: int
    state: str = "unknown"
    direction: str | None = None
    fault_label: str = ""
    fault_text: str = ""
    reason: str | None = None
    """Why the state is unknown although the drive sends something, from ``unknown_reason``."""
    readings: Mapping[str, Reading] = field(default_factory=dict)
    presence: str = "never_seen"
    oldest_value_at: float | None = None
    commanded_hz: float | None = None
    """Last commanded frequency, shown with a star if the drive reports no set frequency."""
    is_model_assumed: bool = False
    """Whether the bus can't tell the model from others; the name then has a question mark behind the model."""

    def name_text(self) -> str:
        """Return the name, with a question mark behind an assumed model."""
        return self.name.replace(self.model, f"{self.model}?", 1) if self.is_model_assumed else self.name

    def cell(self, signal: str) -> str:
        """Format a value with the decimals of the drive's keypad; a dash if the drive does not report it."""
        reading = self.readings.get(signal)
        if reading is None or reading.value is None:
            commanded_hz = self.commanded_hz if signal == "set_frequency" else None
            return "–" if commanded_hz is None else f"{commanded_hz:.2f}*"
        value = reading.value
        text = f"{value:.{_COLUMN_DECIMALS.get(signal, 0)}f}" if isinstance(value, int | float) else str(value)
        return text if reading.quality is Quality.GOOD else f"{text}?"

    def state_text(self) -> str:
        """Return the state in words, or the presence of a drive that does not answer, or not as it should."""
        if self.presence != "online":
            return output.text(f"live.presence.{'unusable' if self.reason else self.presence}")
        return output.text(f"live.state.{self.state}")

    def direction_text(self) -> str:
        return output.text(f"live.direction.{self.direction}") if self.direction else ""

    def fault_cell(self) -> str:
        """Return label and text of the fault, or why the state is unknown."""
        return join_fault(self.fault_label, self.fault_text) or self.reason or ""

    def age_s(self, now: float) -> float | None:
        """Return the age of the oldest value shown."""
        return None if self.oldest_value_at is None else max(0.0, now - self.oldest_value_at)

    def age_text(self, now: float) -> str:
        age = self.age_s(now)
        return "–" if age is None else f"{age:.1f}" if age < 100 else f"{age:.0f}"

    def to_json(self, now: float) -> dict[str, Any]:
        return {
            "drive": self.name,
            "bus": self.bus,
            "model": self.model,
            "model_assumed": self.is_model_assumed,
            "address": self.address,
            "presence": self.presence,
            "state": self.state,
            "reason": self.reason,
            "direction": self.direction,
            "fault": {"label": self.fault_label, "text": self.fault_text}
            if self.fault_label or self.fault_text
            else None,
            "readings": {name: reading_json(reading, now) for name, reading in self.readings.items()},
            "commanded_hz": self.commanded_hz,
            "age_s": round_or_none(self.age_s(now)),
        }


def drive_row(
    status: DriveStatus,
    *,
    key: str,
    name: str,
    bus: str,
    model: str,
    address: int,
    presence: str,
    has_duplicate_address: bool = False,
) -> DriveRow:
    """Return the row of a drive status."""
    times = [reading.source_time for reading in status.readings.values() if reading.source_time is not None]
    fault = status.fault
    return DriveRow(
        key=key,
        name=name,
        bus=bus,
        model=model,
        address=address,
        state=str(status.state),
        direction=str(status.direction) if status.direction else None,
        fault_label=fault.label if fault else "",
        fault_text=output.to_json_value(fault.text) if fault else "",
        reason=unknown_reason(status, presence, address if has_duplicate_address else None),
        readings=status.readings,
        presence=presence,
        oldest_value_at=min(times) if times else status.at,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class BusRow:
    """State and statistics of one bus at one moment."""

    name: str
    settings: str
    up: bool = True
    load: float | None = None
    """Share of the time in which the bus is busy, 0 to 1."""
    transactions_per_s: float | None = None
    errors: Mapping[str, int] = field(default_factory=dict)
    """Counters by kind."""

    def errors_text(self, cells: int | None = None) -> str:
        """Format the counters that are not zero.

        Where ``cells`` do not hold them all: the largest ones and the number of all other errors.
        """
        counts = [(f"{error_kind_text(kind)} {count}", count) for kind, count in self.errors.items() if count]
        text = output.join([phrase for phrase, _ in counts], "phrases") or output.text("live.no_errors")
        if cells is None or output.width(text) <= cells:
            return text
        counts.sort(key=lambda count: -count[1])
        for shown in range(len(counts) - 1, 0, -1):
            largest = output.join([phrase for phrase, _ in counts[:shown]], "phrases")
            text = output.text("live.errors_more", shown=largest, n=sum(n for _, n in counts[shown:]))
            if output.width(text) <= cells:
                return text
        return output.text("live.errors_total", n=sum(n for _, n in counts))

    def to_json(self) -> dict[str, Any]:
        return {
            "bus": self.name,
            "serial": self.settings,
            "up": self.up,
            "load": round_or_none(self.load, 4),
            "transactions_per_s": round_or_none(self.transactions_per_s, 2),
            "errors": dict(self.errors),
        }


def error_kind_text(kind: str) -> str:
    """Return an error kind in the user's language; its name if the catalogue has no text."""
    key = f"live.error.{kind}"
    text = output.text(key)
    return kind if text == key else text
