"""``Bus``: what a program calls. Owns one port through ``shell``; every rule of the bus is in the pure ``core``."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Sequence
from types import TracebackType

from drivebus.bus import timer as timers
from drivebus.bus.poll_schedule import Poll
from drivebus.bus.shell import PollSubscription, Shell
from drivebus.bus.station import Presence, StationHealth
from drivebus.bus.statistics import BusStatistics
from drivebus.bus.trace import TraceEvent
from drivebus.clock import Clock
from drivebus.errors import DrivebusError, PortLost, PortUnavailable
from drivebus.ports.base import Port
from drivebus.protocols.codec import BusRequest, BusResult, StationConfig
from drivebus.serial_settings import SerialSettings


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
        self._start(loop, timer)

    async def close(self) -> None:
        """End everything: what is pending fails with PortLost, the port is let go. Idempotent."""
        loop, self._loop = self._loop, None
        if loop is None:
            return
        if self._reopening is not None:
            self._reopening.cancel()
            await asyncio.gather(self._reopening, return_exceptions=True)
        self._perform(self.core.on_port_lost(PortLost("bus.closed"), self.now()))
        assert self._timer is not None
        self._timer.set(None)
        timers.release(loop)
        await self._close_port()

    async def __aenter__(self) -> Bus:
        await self.open()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    # --- stations ----------------------------------------------------------------------------------------------

    @property
    def settings(self) -> SerialSettings:
        """Baud rate and character format."""
        return self.core.settings

    @property
    def is_open(self) -> bool:
        """Is the port there now? A lost port is opened again by itself."""
        return self.core.is_open

    @property
    def is_closed(self) -> bool:
        """Not opened yet, or closed by whoever owns it: nothing is opened again by itself."""
        return self._loop is None

    @property
    def overdue_s(self) -> float:
        """How long something has been due that was not done: more than moments mean that this loop hangs."""
        return 0.0 if self._timer_at is None else max(0.0, self.now() - self._timer_at)

    def add_station(self, config: StationConfig) -> None:
        """Register a station. Raises ConfigurationError: address taken or broadcast, or families mixed (T18)."""
        self.core.add_station(config)

    def remove_station(self, address: int) -> None:
        """Forget a station; its polls end and its queued asks fail. Raises KeyError."""
        self._perform(self.core.remove_station(address, self.now()))

    def presence(self, address: int) -> Presence:
        """Is the station there? Raises KeyError for an address that is not registered."""
        return self.core.presence(address)

    def health(self, address: int) -> StationHealth:
        """Presence, error rate, foreign master, duplicate address. Raises KeyError for an address without a drive."""
        return self.core.health(address, self.now())

    def stop_epoch(self, address: int) -> int:
        """How many stops this station has had: a permit of an older generation is void."""
        return self.core.stations[address].stop_epoch

    def inhibit_start(self, addresses: Iterable[int] | None = None) -> None:
        """No frame that may move a motor leaves for these stations (None: all) until ``release``."""
        self.core.set_start_inhibit(addresses, True)

    def release_start(self, addresses: Iterable[int] | None = None) -> None:
        """The reset after a bus stop: motion is allowed again, nothing starts by itself."""
        self.core.set_start_inhibit(addresses, False)

    def start_inhibited(self, address: int) -> bool:
        """Does a bus stop hold this station? Raises KeyError."""
        return self.core.stations[address].start_inhibited

    # --- traffic -----------------------------------------------------------------------------------------------

    def now(self) -> float:
        """Monotonic seconds: the time of everything that this bus says. On Linux they go on while the system sleeps."""
        if self._clock is not None:
            return self._clock()
        return timers.loop_now(asyncio.get_running_loop())

    async def transact(self, bus_request: BusRequest) -> BusResult:
        """Do one transaction; what went wrong is ``answer.error``. Raises ValueError for a request out of range.

        Cancelled while it waits in a queue, it is never sent; while its frame is out, its answer is dropped.
        """
        future = self.submit(bus_request)
        try:
            return await future
        except asyncio.CancelledError:
            self._perform(self.core.cancel(future, self.now()))
            raise

    def submit(self, bus_request: BusRequest) -> asyncio.Future[BusResult]:
        """Queue one transaction at this very instant (``transact`` in two halves). Raises ValueError as that does."""
        future: asyncio.Future[BusResult] = (self._loop or asyncio.get_running_loop()).create_future()
        self._perform(self.core.submit(bus_request, future, self.now()))
        return future

    def start_polling(
        self, address: int, polls: Sequence[Poll], on_result: Callable[[BusResult], None]
    ) -> PollSubscription:
        """Send these polls again and again; ``sink`` gets each answer, errors too. Raises KeyError, ValueError."""
        watch = PollSubscription(self._stop_polling, on_result)
        self._perform(self.core.start_polling(address, polls, watch, self.now()))
        return watch

    def _stop_polling(self, watch: PollSubscription) -> None:
        self._perform(self.core.stop_polling(watch, self.now()))

    def statistics(self) -> BusStatistics:
        """Load, rates, reply times, errors and bytes, of the bus and of each station."""
        return self.core.statistics(self.now())

    def trace(self, sink: Callable[[TraceEvent], None]) -> Callable[[], None]:
        """Hand every frame on the wire to ``sink``; returns what ends it."""
        self._trace_sinks.append(sink)
        self.core.tracing = True
        return lambda: self._untrace(sink)

    def _untrace(self, sink: Callable[[TraceEvent], None]) -> None:
        if sink in self._trace_sinks:
            self._trace_sinks.remove(sink)
        self.core.tracing = bool(self._trace_sinks)
