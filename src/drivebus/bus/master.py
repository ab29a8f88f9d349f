"""``Bus``: what a program calls. Owns one port through ``shell``; every rule of the bus is in the pure ``core``."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Sequence
from types import TracebackType

from drivebus.bus import timer as timers
from drivebus.bus.planner import Poll
from drivebus.bus.shell import Shell, Watch
from drivebus.bus.stations import Health, Presence
from drivebus.bus.statistics import BusStatistics
from drivebus.bus.trace import TraceEvent
from drivebus.errors import DrivebusError, PortLost, PortUnavailable
from drivebus.line import LineSettings
from drivebus.message import Answer, Ask, StationLink
from drivebus.ports.port import Port
from drivebus.seams import Clock


class Bus(Shell):
    """One master on one port. Belongs to one event loop; every method is called from it."""

    def __init__(self, port: Port, *, name: str = "", allow_mixed: bool = False, clock: Clock | None = None) -> None:
        super().__init__(port, name, allow_mixed, clock)

    # --- life --------------------------------------------------------------------------------------------------

    async def open(self) -> None:
        """Open the port and begin. Raises PortUnavailable with why and what to do."""
        if self._loop is not None:
            return
        loop = asyncio.get_running_loop()
        timer = timers.acquire(loop)
        try:
            await self.port.open(self)
        except BaseException as error:
            timers.release(loop)
            if isinstance(error, DrivebusError) or not isinstance(error, Exception):
                raise
            reason = getattr(error, "strerror", None) or str(error)
            raise PortUnavailable("ports.failed", port=self.port.url, reason=reason) from error
        self._begin(loop, timer)

    async def close(self) -> None:
        """End everything: what is pending fails with PortLost, the port is let go. Idempotent."""
        loop, self._loop = self._loop, None
        if loop is None:
            return
        if self._reopening is not None:
            self._reopening.cancel()
            await asyncio.gather(self._reopening, return_exceptions=True)
        self._perform(self.core.lost(PortLost("bus.closed"), self.now()))
        assert self._alarm is not None
        self._alarm.set(None)
        timers.release(loop)
        await self._let_go()

    async def __aenter__(self) -> Bus:
        await self.open()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    # --- stations ----------------------------------------------------------------------------------------------

    @property
    def line(self) -> LineSettings:
        """Baud rate and character format."""
        return self.core.line

    @property
    def is_open(self) -> bool:
        """Is the port there now? A lost port is opened again by itself."""
        return self.core.is_open

    @property
    def is_closed(self) -> bool:
        """Not opened yet, or closed by whoever owns it: nothing is opened again by itself."""
        return self._loop is None

    @property
    def late_s(self) -> float:
        """How long something has been due that was not done: more than moments mean that this loop hangs."""
        return 0.0 if self._wake_at is None else max(0.0, self.now() - self._wake_at)

    def add(self, link: StationLink) -> None:
        """Register a station. Raises ConfigurationError: address taken or broadcast, or families mixed (T18)."""
        self.core.add(link)

    def remove(self, address: int) -> None:
        """Forget a station; its polls end and its queued asks fail. Raises KeyError."""
        self._perform(self.core.remove(address, self.now()))

    def presence(self, address: int) -> Presence:
        """Is the station there? Raises KeyError for an address that is not registered."""
        return self.core.presence(address)

    def health(self, address: int) -> Health:
        """Presence, error rate, foreign master, duplicate address. Raises KeyError for an address without a drive."""
        return self.core.health(address, self.now())

    def generation(self, address: int) -> int:
        """How many stops this station has had: a permit of an older generation is void."""
        return self.core.stations[address].generation

    def latch(self, addresses: Iterable[int] | None = None) -> None:
        """No frame that may move a motor leaves for these stations (None: all) until ``release``."""
        self.core.latch(addresses, True)

    def release(self, addresses: Iterable[int] | None = None) -> None:
        """The reset after a bus stop: motion is allowed again, nothing starts by itself."""
        self.core.latch(addresses, False)

    def latched(self, address: int) -> bool:
        """Does a bus stop hold this station? Raises KeyError."""
        return self.core.stations[address].latched

    # --- traffic -----------------------------------------------------------------------------------------------

    def now(self) -> float:
        """Monotonic seconds: the time of everything that this bus says. On Linux they go on while the system sleeps."""
        if self._clock is not None:
            return self._clock()
        return timers.clock_of(asyncio.get_running_loop())

    async def transact(self, ask: Ask) -> Answer:
        """Do one transaction; what went wrong is ``answer.error``. Raises ValueError for a request out of range.

        Cancelled while it waits in a queue, it is never sent; while its frame is out, its answer is dropped.
        """
        future = self.submit(ask)
        try:
            return await future
        except asyncio.CancelledError:
            self._perform(self.core.cancel(future, self.now()))
            raise

    def submit(self, ask: Ask) -> asyncio.Future[Answer]:
        """Queue one transaction at this very instant (``transact`` in two halves). Raises ValueError as that does."""
        future: asyncio.Future[Answer] = (self._loop or asyncio.get_running_loop()).create_future()
        self._perform(self.core.submit(ask, future, self.now()))
        return future

    def watch(self, address: int, polls: Sequence[Poll], sink: Callable[[Answer], None]) -> Watch:
        """Send these polls again and again; ``sink`` gets each answer, errors too. Raises KeyError, ValueError."""
        watch = Watch(self._unwatch, sink)
        self._perform(self.core.watch(address, polls, watch, self.now()))
        return watch

    def _unwatch(self, watch: Watch) -> None:
        self._perform(self.core.unwatch(watch, self.now()))

    def statistics(self) -> BusStatistics:
        """Load, rates, reply times, errors and bytes, of the bus and of each station."""
        return self.core.statistics(self.now())

    def trace(self, sink: Callable[[TraceEvent], None]) -> Callable[[], None]:
        """Hand every frame on the wire to ``sink``; returns what ends it."""
        self._tracers.append(sink)
        self.core.tracing = True
        return lambda: self._untrace(sink)

    def _untrace(self, sink: Callable[[TraceEvent], None]) -> None:
        if sink in self._tracers:
            self._tracers.remove(sink)
        self.core.tracing = bool(self._tracers)
