"""One line of the plant: a bus with its drives, opened again and again until it is open, and what was last on it."""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

from drivebus import open_bus
from drivebus.bus import Bus
from drivebus.bus.load import estimate_bus_load
from drivebus.bus.trace import TraceEvent
from drivebus.drives.state import DriveStatus
from drivebus.drives.store import Store
from drivebus.errors import DrivebusError
from drivebus.profiles.model import DriveProfile
from drivebus.service.config.bus_load import serial_settings_of
from drivebus.service.config.model import BusConfig, DriveConfig
from drivebus.service.runtime.drive import DriveRuntime
from drivebus.types import Json

REOPEN_INTERVAL_S = 2.0
"""A bus that can't be opened is tried again after this, for ever."""
MAX_KEPT_FRAMES = 500


class TracedFrame(NamedTuple):
    """One frame on the wire, counted from 1."""

    number: int
    time_ms: int
    event: TraceEvent


class BusRuntime:
    """A bus and its units. ``profile`` gives the line what the setting and the LINK leave open.

    ``told`` is called with an i18n key and its numbers where it can't be opened, once.
    """

    def __init__(
        self,
        config: BusConfig,
        profile: DriveProfile | None,
        *,
        wall_ms: Callable[[], int],
        on_problem: Callable[[str, Json], None],
        on_frame: Callable[[BusRuntime, TracedFrame], None],
    ) -> None:
        self.config, self._wall_ms, self._on_problem, self._on_frame = config, wall_ms, on_problem, on_frame
        bus_runtime = serial_settings_of(config, profile)
        self.bus: Bus = open_bus(config.link, baud=bus_runtime.baud, format=bus_runtime.format)
        self.drives: dict[str, DriveRuntime] = {}
        self.problem: DrivebusError | None = None
        """Why it could not be opened, None where it was."""
        self.frames: deque[TracedFrame] = deque(maxlen=MAX_KEPT_FRAMES)
        self._stop_bound: tuple[Any, float | None] = ((), None)
        """For which polls, and the bound: computed anew only when they change."""
        self.frame_count = 0
        self._opening: asyncio.Task[None] | None = None
        self._untrace = self.bus.trace(self._on_trace)

    def stop_bound_s(self) -> float | None:
        """The longest time until a stop's last bit is out, for the slowest drive of the line (5.1)."""
        polled = tuple((runtime.drive.dialect.station_config, tuple(runtime.polls)) for runtime in self.drives.values())
        if polled != self._stop_bound[0]:
            drives = estimate_bus_load(polled, self.bus.settings).drives
            self._stop_bound = polled, max((drive.stop_bound_s for drive in drives.values()), default=None)
        return self._stop_bound[1]

    def add_drive(
        self,
        config: DriveConfig,
        *,
        on_status: Callable[[DriveRuntime, DriveStatus], None],
        store: Store | None = None,
    ) -> DriveRuntime:
        """Add a drive to the bus. Raises ConfigurationError, ProfileError."""
        drive = DriveRuntime(config, self.bus, on_status=on_status, store=store)
        self.drives[config.id] = drive
        if not self.bus.is_closed:
            drive.start_monitor()
        return drive

    def remove_drive(self, id: str) -> None:
        """Take a drive off the line; the others' polls go on."""
        self.drives.pop(id).close()

    def start(self) -> None:
        """Open the bus, now or when it can be; nobody waits for it."""
        self._opening = asyncio.create_task(self._open(), name=f"open {self.config.id}")

    async def _open(self) -> None:
        while True:
            try:
                await self.bus.open()
            except DrivebusError as error:
                if self.problem is None:
                    self._on_problem("plant.bus_not_open", {"bus": self.config.id, "why": error})
                self.problem = error
                await asyncio.sleep(REOPEN_INTERVAL_S)
            else:
                break
        self.problem = None
        for runtime in self.drives.values():
            runtime.start_monitor()

    async def close(self) -> None:
        """Sends nothing more."""
        if self._opening is not None:
            self._opening.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._opening
        for id in tuple(self.drives):
            self.remove_drive(id)
        self._untrace()
        await self.bus.close()

    def _on_trace(self, event: TraceEvent) -> None:
        self.frame_count += 1
        seen = TracedFrame(self.frame_count, self._wall_ms(), event)
        self.frames.append(seen)
        self._on_frame(self, seen)
