"""Runtime of one bus: its drives, its newest frames, and the attempts to open it."""

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
from drivebus.drives.outcome import Outcome
from drivebus.drives.state import DriveStatus
from drivebus.drives.stop_supervisor import JointStops
from drivebus.drives.store import Store
from drivebus.errors import DrivebusError
from drivebus.profiles.model import DriveProfile
from drivebus.service.config.adapter_latency import AdapterLatency, adapter_latency, serial_device
from drivebus.service.config.bus_load import serial_settings_of
from drivebus.service.config.model import BusConfig, DriveConfig, title_of
from drivebus.service.one_at_a_time import OneAtATime
from drivebus.service.runtime.drive import DriveRuntime
from drivebus.types import Json
from drivebus.values import Text, bilingual_text

OPEN_RETRY_INTERVAL_S = 2.0  # between attempts to open a bus that could not be opened
MAX_BUFFERED_FRAMES = 500


class TracedFrame(NamedTuple):
    """A frame on the wire. Numbers count from 1."""

    number: int
    time_ms: int
    event: TraceEvent


class BusRuntime:
    """A bus and its drives. ``profile`` completes the serial settings that configuration and port leave open.

    ``on_problem`` is called once with an i18n key and its parameters when the bus can't be opened.
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
        settings = serial_settings_of(config, profile)
        self.bus: Bus = open_bus(config.port, baud=settings.baud, format=settings.format)
        self._serial_device = serial_device(config.port)
        """Read from the port URL once: a file name is no port URL while the adapter is pulled."""
        self.drives: dict[str, DriveRuntime] = {}
        self.reads = OneAtATime()
        """Reads of parameters and identities, and loop-back tests, for users.

        Many at once would go before the reads that confirm a stop.
        """
        self.automatic_stops = JointStops()
        """Stops by interlocks and other policies, which often concern all drives of a bus."""
        self.problem: DrivebusError | None = None
        """Reason why the bus is not open."""
        self.has_opened = False
        """Whether the port has been open once; the bus opens one that is lost afterwards again by itself."""
        self.reported_open: bool | None = None
        """Whether the port was last reported as open; None before the first report."""
        self.frames: deque[TracedFrame] = deque(maxlen=MAX_BUFFERED_FRAMES)
        self._stop_bound: tuple[Any, float | None] = ((), None)
        """Polls and the bound that follows from them, computed again only when they change."""
        self.frame_count = 0
        self._opening: asyncio.Task[None] | None = None
        self._untrace = self.bus.trace(self._on_trace)

    @property
    def title(self) -> Text:
        """Name of the bus in a sentence: its title, else "bus" and its id, which is the title of a file without one."""
        title, id = title_of(self.config), self.config.id
        return title if title != Text(id, id) else bilingual_text("plant.bus", id=id)

    def stop_bound_s(self) -> float | None:
        """Return the longest time to the last bit of a stop, for the slowest drive of the bus."""
        polled = tuple((runtime.drive.dialect.station_config, tuple(runtime.polls)) for runtime in self.drives.values())
        if polled != self._stop_bound[0]:
            drives = estimate_bus_load(polled, self.bus.settings).drives
            self._stop_bound = polled, max((drive.stop_bound_s for drive in drives.values()), default=None)
        return self._stop_bound[1]

    def adapter_latency(self) -> AdapterLatency | None:
        """Return what the adapter costs this bus while it holds received bytes back, None where it does not."""
        polled = [(runtime.drive.dialect.station_config, runtime.polls) for runtime in self.drives.values()]
        return adapter_latency(self.config.id, self._serial_device, polled, self.bus.settings)

    def add_drive(
        self,
        config: DriveConfig,
        *,
        on_status: Callable[[DriveRuntime, DriveStatus], None],
        on_repeated_stop: Callable[[DriveRuntime, Outcome], None],
        store: Store | None,
    ) -> DriveRuntime:
        """Add a drive to the bus. Raises ConfigurationError, ProfileError."""
        drive = DriveRuntime(config, self.bus, on_status=on_status, on_repeated_stop=on_repeated_stop, store=store)
        self.drives[config.id] = drive
        if not self.bus.is_closed:
            drive.start_monitor()
        return drive

    def remove_drive(self, id: str) -> None:
        """Remove a drive; polling of the others continues."""
        self.drives.pop(id).close()

    def start(self) -> None:
        """Start to open the bus, and repeat it until it is open."""
        self._opening = asyncio.create_task(self._open(), name=f"open {self.config.id}")

    async def _open(self) -> None:
        while True:
            try:
                await self.bus.open()
            except DrivebusError as error:
                if self.problem is None:
                    self._on_problem("plant.bus_not_open", {"bus": self.title, "why": error})
                self.problem = error
                await asyncio.sleep(OPEN_RETRY_INTERVAL_S)
            else:
                break
        self.problem, self.has_opened = None, True
        for runtime in self.drives.values():
            runtime.start_monitor()

    async def close(self) -> None:
        """Close the bus; nothing more is sent."""
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
        frame = TracedFrame(self.frame_count, self._wall_ms(), event)
        self.frames.append(frame)
        self._on_frame(self, frame)
