"""One line of the plant: a bus with its drives, opened again and again until it is open, and what was last on it."""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

from drivebus import open_bus
from drivebus.bus import Bus
from drivebus.bus.planner import arithmetic
from drivebus.bus.trace import TraceEvent
from drivebus.errors import DrivebusError
from drivebus.plant.config.polling import line_of
from drivebus.plant.model import BusSetting, DriveSetting
from drivebus.plant.units import Unit
from drivebus.plant.view import Sample
from drivebus.profiles.model import DriveProfile
from drivebus.seams import Store

AGAIN_S = 2.0
"""A bus that can't be opened is tried again after this, for ever."""
KEPT_FRAMES = 500


class Seen(NamedTuple):
    """One frame on the wire, counted from 1."""

    number: int
    time_ms: int
    event: TraceEvent


class Line:
    """A bus and its units. ``profile`` gives the line what the setting and the LINK leave open.

    ``told`` is called with an i18n key and its numbers where it can't be opened, once.
    """

    def __init__(
        self,
        setting: BusSetting,
        profile: DriveProfile | None,
        told: Callable[[str, dict[str, Any]], None],
        on_frame: Callable[[Line, Seen], None],
    ) -> None:
        self.setting, self._told, self._on_frame = setting, told, on_frame
        line = line_of(setting, profile)
        self.bus: Bus = open_bus(setting.link, baud=line.baud, format=line.format)
        self.units: dict[str, Unit] = {}
        self.problem: DrivebusError | None = None
        """Why it could not be opened, None where it was."""
        self.frames: deque[Seen] = deque(maxlen=KEPT_FRAMES)
        self._bound: tuple[Any, float | None] = ((), None)
        """For which polls, and the bound: computed anew only when they change."""
        self.count = 0
        self.wall_ms: Callable[[], int] = lambda: 0
        self._opening: asyncio.Task[None] | None = None
        self._untrace = self.bus.trace(self._traced)

    def stop_bound_s(self) -> float | None:
        """The longest time until a stop's last bit is out, for the slowest drive of the line (5.1)."""
        polled = tuple((unit.drive.dialect.link, tuple(unit.polls)) for unit in self.units.values())
        if polled != self._bound[0]:
            drives = arithmetic(polled, self.bus.line).drives
            self._bound = polled, max((drive.stop_bound_s for drive in drives.values()), default=None)
        return self._bound[1]

    def add(self, setting: DriveSetting, samples: Callable[[list[Sample]], None], store: Store | None = None) -> Unit:
        """Put a drive on the line. Raises ConfigurationError, ProfileError."""
        unit = Unit(setting, self.bus, samples, store)
        unit.wall_ms = self.wall_ms
        self.units[setting.id] = unit
        if not self.bus.is_closed:
            unit.watch()
        return unit

    def remove(self, id: str) -> None:
        """Take a drive off the line; the others' polls go on."""
        self.units.pop(id).close()

    def start(self) -> None:
        """Open the bus, now or when it can be; nobody waits for it."""
        self._opening = asyncio.create_task(self._open(), name=f"open {self.setting.id}")

    async def _open(self) -> None:
        while True:
            try:
                await self.bus.open()
            except DrivebusError as error:
                if self.problem is None:
                    self._told("plant.bus_not_open", {"bus": self.setting.id, "why": error})
                self.problem = error
                await asyncio.sleep(AGAIN_S)
            else:
                break
        self.problem = None
        for unit in self.units.values():
            unit.watch()

    async def close(self) -> None:
        """Sends nothing more."""
        if self._opening is not None:
            self._opening.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._opening
        for id in tuple(self.units):
            self.remove(id)
        self._untrace()
        await self.bus.close()

    def _traced(self, event: TraceEvent) -> None:
        self.count += 1
        seen = Seen(self.count, self.wall_ms(), event)
        self.frames.append(seen)
        self._on_frame(self, seen)
