"""Rows of drives and buses, from polls of a real bus and from recorded replies. Sends only reads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from drivebus.cli import output
from drivebus.cli.tui.rows import COLUMN_SIGNALS, ERROR_COUNTERS, BusRow, DriveRow, unknown_reason
from drivebus.drives.dialects.base import reported_fault
from drivebus.drives.readings import ReadingPairs
from drivebus.drives.state import STATE_NOT_READ, DerivedState, DriveStatus

if TYPE_CHECKING:
    from drivebus.bus import Bus
    from drivebus.drives import Drive
    from drivebus.drives.dialects.base import Dialect


class RecordedDrive:
    """Drive of a capture: its state, derived from recorded replies by the library's own dialect."""

    def __init__(self, dialect: Dialect, key: str, name: str, bus_name: str) -> None:
        self.dialect = dialect
        self.key, self.name, self.bus_name = key, name, bus_name
        self._readings = ReadingPairs()
        self._state: DerivedState = STATE_NOT_READ
        self._received_at: float | None = None

    def on_reply(self, request: Any, reply: Any, at: float | None) -> None:
        """Add the values of one reply; a rejection contains none."""
        if self.dialect.rejection(reply) is not None:
            return
        self._received_at = at
        self._readings.add(self.dialect.decode_readings(request, reply, at))
        if self.dialect.reports_run_state:
            self._state = self.dialect.derive_state(self._readings) or self._state

    def row(self, presence: str) -> DriveRow:
        """Return the row of the latest values."""
        profile, state = self.dialect.profile, self._state
        fault = reported_fault(profile, state)
        readings = {name: reading for name, reading in self._readings.latest.items() if name in profile.signals}
        status = DriveStatus(
            state=state.state,
            direction=state.direction,
            fault=fault,
            readings=readings,
            reason=state.reason,
            at=self._received_at,
        )
        return drive_row(
            status,
            key=self.key,
            name=self.name,
            bus=self.bus_name,
            model=profile.model,
            address=self.dialect.address,
            presence=presence,
        )


class PolledDrive:
    """Drive on a real bus, polled by the library's monitor."""

    def __init__(self, drive: Drive, key: str, name: str, bus_name: str) -> None:
        self.drive = drive
        self.key, self.name, self.bus_name = key, name, bus_name
        self._monitor = drive.monitor(name for name in COLUMN_SIGNALS if name in drive.profile.signals)

    def row(self) -> DriveRow:
        """Return the row of the latest values; the monitor has marked the outdated ones."""
        bus, address = self.drive.bus, self.drive.address
        health, status = bus.health(address), self._monitor.status()
        return drive_row(
            status,
            key=self.key,
            name=self.name,
            bus=self.bus_name,
            model=self.drive.profile.model,
            address=address,
            presence=str(health.presence),
        )

    def stop(self) -> None:
        """End the polls. Idempotent."""
        self._monitor.close()


def drive_row(
    status: DriveStatus, *, key: str, name: str, bus: str, model: str, address: int, presence: str
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
        reason=unknown_reason(status, presence),
        readings=status.readings,
        presence=presence,
        oldest_value_at=min(times) if times else status.at,
    )


@dataclass(slots=True)
class PolledBus:
    """Real bus of a live view."""

    bus: Bus
    name: str

    def row(self) -> BusRow:
        """Return the row of the bus and its statistics."""
        statistics = self.bus.statistics()
        counters = {kind: count for kind, count in statistics.counters.items() if kind in ERROR_COUNTERS}
        return BusRow(
            name=self.name,
            settings=str(self.bus.settings),
            up=self.bus.is_open,
            load=statistics.load_percent / 100.0,
            transactions_per_s=statistics.transactions_per_s,
            errors={**statistics.errors, **counters},
        )
