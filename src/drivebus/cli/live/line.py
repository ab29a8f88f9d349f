"""The live view of one real line: polls its drives, commands nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from drivebus.cli import voice
from drivebus.cli.live.model import DriveRow, LineRow
from drivebus.cli.live.watch import WatchedDrive, WatchedLine

if TYPE_CHECKING:
    from drivebus.bus import Bus
    from drivebus.ports.port import Port
    from drivebus.profiles import DriveProfile


class LineFeed:
    """A ``Feed`` over a port: which models in which encoding at which addresses is known beforehand."""

    def __init__(self, port: Port, known: Sequence[tuple[DriveProfile, str | None, int]], title: str) -> None:
        self.title = title
        self._port = port
        self._known = known
        self._bus: Bus | None = None
        self._drives: list[WatchedDrive] = []
        self._up = True
        self._news = [voice.say("monitor.feeds")]

    async def start(self) -> None:
        """Open the port and begin to poll. Raises PortUnavailable."""
        from drivebus.bus import Bus
        from drivebus.drives import Drive

        self._bus = Bus(self._port, allow_mixed=True)
        await self._bus.open()
        for profile, encoding, address in self._known:
            drive = Drive(self._bus, profile, address, encoding=encoding)
            name = f"{profile.model} {address}"
            self._drives.append(WatchedDrive(drive, name, name, self._bus.name))

    async def close(self) -> None:
        if self._bus is not None:
            await self._bus.close()

    def now(self) -> float:
        return self._bus.now() if self._bus is not None else 0.0

    def drives(self) -> list[DriveRow]:
        return [drive.row() for drive in self._drives]

    def lines(self) -> list[LineRow]:
        if self._bus is None:
            return []
        row = WatchedLine(self._bus, self._port.identity.rpartition("/")[2] or self._bus.name).row()
        if row.up != self._up:
            self._up = row.up
            self._news.append(voice.say("monitor.back" if row.up else "monitor.lost"))
        return [row]

    def news(self) -> list[str]:
        return self._news

    over = False
