"""Reports of a drive's state during one operation: what the sentence of an unconfirmed stop is made of."""

from __future__ import annotations

from drivebus.drives.readings import Readings
from drivebus.drives.state import DerivedState
from drivebus.errors import DrivebusError, ProtocolError
from drivebus.values import Quality, Text, bilingual_text

RECEIVED_BYTES_KEYS = frozenset(
    {
        "bus.late_reply",
        "bus.offline_bytes",
        "bus.truncated",
        "bus.line_errors",
        "bus.collision",
        "bus.sync_rejected",
        "drives.sync_probe_rejected",
    }
)
"""Errors of the bus that name received bytes, beside every ``ProtocolError``."""


class StateReports:
    """Newest reported state, the number of reads in a row that showed it, and the failed reads since then.

    It outlives the reads of a state that was interrupted, whose own result is not known then.
    """

    def __init__(self) -> None:
        self.newest: DerivedState | None = None
        self.output_hz: float | None = None
        self.count = 0
        self.failures = 0
        self.unusable: Text | None = None
        """Why the last received bytes showed no state."""

    def add(self, derived: DerivedState | None, readings: Readings) -> None:
        """Add the state that one read showed, None where it showed none."""
        reading = readings.get("output_frequency")
        good = reading is not None and reading.quality is Quality.GOOD and isinstance(reading.value, int | float)
        same = derived is not None and self.newest is not None and derived.state is self.newest.state
        if derived is None:
            self.failures += 1
            return
        self.newest, self.failures = derived, 0
        self.count = self.count + 1 if same else 1
        self.output_hz = float(reading.value) if good and reading is not None else None  # type: ignore[arg-type]

    def add_failure(self, error: DrivebusError) -> None:
        """Add a read without a valid reply."""
        self.failures += 1
        self.name_unusable(error)

    def name_unusable(self, error: DrivebusError) -> None:
        """Keep the reason of a frame whose reply was received and not accepted."""
        if isinstance(error, ProtocolError) or error.key in RECEIVED_BYTES_KEYS:
            self.unusable = bilingual_text(error.key, **error.params)
