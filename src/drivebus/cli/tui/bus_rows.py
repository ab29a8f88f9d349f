"""Rows from real buses and from recorded replies, judged as the library judges them. Reads only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from drivebus.cli import output
from drivebus.cli.tui.rows import COLUMN_SIGNALS, BusRow, DriveRow
from drivebus.drives.dialects.base import fault_from_code
from drivebus.drives.readings import ReadingPairs
from drivebus.drives.state import STATE_NOT_READ, DerivedState, DriveStatus

if TYPE_CHECKING:
    from drivebus.bus import Bus
    from drivebus.drives import Drive
    from drivebus.drives.dialects.base import Dialect


class RecordedDrive:
    """What one drive's replies say, judged as the library judges them."""

    def __init__(self, dialect: Dialect, key: str, name: str, line: str) -> None:
        self.dialect = dialect
        self.key, self.name, self.line = key, name, line
        self._book = ReadingPairs()
        self._verdict: DerivedState = STATE_NOT_READ
        self._at: float | None = None

    def on_reply(self, request: Any, reply: Any, at: float | None) -> None:
        """Take in one reply; a refusal says nothing of the drive's values."""
        if self.dialect.rejection(reply) is not None:
            return
        self._at = at
        self._book.add(self.dialect.decode_readings(request, reply, at))
        verdict = self.dialect.derive_state(self._book) if self.dialect.reports_run_state else None
        self._verdict = verdict or self._verdict

    def row(self, presence: str) -> DriveRow:
        """The drive as it is known now."""
        profile, verdict = self.dialect.profile, self._verdict
        fault = None if verdict.fault_code is None else fault_from_code(profile, verdict.fault_code)
        readings = {name: one for name, one in self._book.latest.items() if name in profile.signals}
        status = DriveStatus(verdict.state, verdict.direction, fault, readings, verdict.reason, self._at)
        return drive_row(self.key, self.name, self.line, profile.model, self.dialect.address, status, presence)


class PolledDrive:
    """One drive of a live view on a real bus: the library's own monitor, as a row."""

    def __init__(self, drive: Drive, key: str, name: str, line: str) -> None:
        self.drive = drive
        self.key, self.name, self.line = key, name, line
        self._monitor = drive.monitor(name for name in COLUMN_SIGNALS if name in drive.profile.signals)

    def row(self) -> DriveRow:
        """The drive as it is known now; what is too old is marked so by the monitor."""
        bus, address = self.drive.bus, self.drive.address
        health, status = bus.health(address), self._monitor.status()
        return drive_row(
            self.key, self.name, self.line, self.drive.profile.model, address, status, str(health.presence)
        )

    def stop(self) -> None:
        """No more polls. Idempotent."""
        self._monitor.close()


def drive_row(key: str, name: str, line: str, model: str, address: int, status: DriveStatus, presence: str) -> DriveRow:
    """A status as a row."""
    times = [reading.source_time for reading in status.readings.values() if reading.source_time is not None]
    fault = status.fault
    return DriveRow(
        key,
        name,
        line,
        model,
        address,
        str(status.state),
        str(status.direction) if status.direction else None,
        fault.label if fault else "",
        output.to_json_value(fault.text) if fault else "",
        status.readings,
        presence,
        min(times) if times else status.at,
    )


@dataclass(slots=True)
class PolledBus:
    """One line of a live view."""

    bus: Bus
    name: str

    def row(self) -> BusRow:
        """The line as it is now."""
        found = self.bus.statistics()
        counted = {kind: count for kind, count in found.counters.items() if kind in _SHOWN_COUNTERS}
        return BusRow(
            self.name,
            str(self.bus.settings),
            self.bus.is_open,
            found.load_percent / 100.0,
            found.transactions_per_s,
            {**found.errors, **counted},
        )


_SHOWN_COUNTERS = frozenset(
    {"late", "foreign", "duplicate", "unsolicited", "foreign_request", "collision", "line_errors"}
)
