"""Rows of one real bus: polls its drives, sends no command."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from drivebus.cli import output
from drivebus.cli.tui.bus_rows import PolledBus, PolledDrive
from drivebus.cli.tui.rows import BusRow, DriveRow

if TYPE_CHECKING:
    from drivebus.bus import Bus
    from drivebus.ports.base import Port
    from drivebus.profiles import DriveProfile


class BusRowSource:
    """Row source of a port whose drives (profile, encoding, address) are known."""

    def __init__(
        self,
        port: Port,
        stations: Sequence[tuple[DriveProfile, str | None, int]],
        title: str,
        notes: Sequence[str] = (),
        assumed: Collection[int] = (),
    ) -> None:
        """``notes``: messages on the drives. ``assumed``: addresses whose model the bus can't tell from others."""
        self.title = title
        self._port = port
        self._stations = stations
        self._assumed = assumed
        self._bus: Bus | None = None
        self._drives: list[PolledDrive] = []
        self._was_open = True
        self._messages = [output.text("monitor.comm_loss"), *notes]

    async def start(self) -> None:
        """Open the port and start the polls. Raises PortUnavailable."""
        from drivebus.bus import Bus
        from drivebus.drives import Drive

        self._bus = Bus(self._port, allow_mixed=True)
        await self._bus.open()
        for profile, encoding, address in self._stations:
            drive = Drive(self._bus, profile, address, encoding=encoding)
            name = f"{profile.model} {address}"
            self._drives.append(PolledDrive(drive, name, name, self._bus.name))

    async def close(self) -> None:
        if self._bus is not None:
            await self._bus.close()

    def now(self) -> float:
        return self._bus.now() if self._bus is not None else 0.0

    def drives(self) -> list[DriveRow]:
        rows = [drive.row() for drive in self._drives]
        return [replace(row, is_model_assumed=row.address in self._assumed) for row in rows]

    def buses(self) -> list[BusRow]:
        if self._bus is None:
            return []
        row = PolledBus(self._bus, self._port.identity.rpartition("/")[2] or self._bus.name).row()
        if row.up != self._was_open:
            self._was_open = row.up
            self._messages.append(output.text("monitor.back" if row.up else "monitor.lost"))
        return [row]

    def messages(self) -> list[str]:
        return self._messages

    finished = False
