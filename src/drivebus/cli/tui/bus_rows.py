"""Rows of the drives of a real bus, polled by its monitors, and of the bus itself. Sends only reads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from drivebus.cli.tui.rows import COLUMN_SIGNALS, ERROR_COUNTERS, BusRow, DriveRow, drive_row

if TYPE_CHECKING:
    from drivebus.bus import Bus
    from drivebus.drives import Drive


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
            has_duplicate_address=health.duplicate_address,
        )

    def stop(self) -> None:
        """End the polls. Idempotent."""
        self._monitor.close()


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
