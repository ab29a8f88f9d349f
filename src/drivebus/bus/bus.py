"""``Bus``: the master of one port: it drives the engine in ``core`` with the port, the clock and a timer.

No rule of the bus is decided here.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Iterable, Sequence
from math import inf
from types import TracebackType
from typing import Any

from drivebus.bus import timer as timers
from drivebus.bus.commands import CoreCommand, DeliverResult, EmitTrace, Send
from drivebus.bus.core import BusCore
from drivebus.bus.messages import BusRequest, BusResult, StationConfig
from drivebus.bus.prepared_request import Poll
from drivebus.bus.station import Presence, StationHealth
from drivebus.bus.statistics import BusStatistics
from drivebus.bus.trace import TraceEvent
from drivebus.bus.transaction_future import TransactionFuture
from drivebus.errors import DrivebusError, PortLost, PortUnavailable, SystemReason
from drivebus.ports.base import PausableReader, PendingReader, Port
from drivebus.serial_settings import SerialSettings

REOPEN_INTERVAL_S = 0.4  # between attempts to open a lost port: polling resumes within 2 s of the device's return
SPIN_THRESHOLD_S = 40e-6  # a shorter wait is spent in a loop: setting a timer and sleeping takes longer
HIDDEN_WAKE_UP_MAX_CHARACTER_S = 105e-6  # of 115,200 baud 8E2; there a timer wakes up for a good part of the gap
FAST_BUS_CHARACTER_S = 30e-6  # faster than 350,000 baud: gaps are waited out in a loop, else the reader is paused
MIN_READER_PAUSE_S = 0.001  # pausing the reader costs a system call, so it must save more than this


class PollSubscription:
    """Subscription to the polls of one ``Bus.start_polling``."""

    __slots__ = ("_make_due", "_stop", "on_result")

    def __init__(
        self,
        stop: Callable[[PollSubscription], None],
        make_due: Callable[[PollSubscription, Collection[Any]], None],
        on_result: Callable[[BusResult], None],
    ) -> None:
        self._stop = stop
        self._make_due = make_due
        self.on_result = on_result

    def make_due(self, requests: Collection[Any]) -> None:
        """Send the polls of these requests now instead of at the end of their period."""
        self._make_due(self, requests)

    def cancel(self) -> None:
        """End the polls; no further result is delivered. Idempotent."""
        self._stop(self)


class Bus:
    """Master on one port. It belongs to one event loop, from which every method is called."""

    def __init__(
        self,
        port: Port,
        *,
        name: str = "",
        allow_mixed: bool = False,
        clock: Callable[[], float] | None = None,
    ) -> None:
        """``allow_mixed``: stations of different protocols may share the bus where no frame can be mistaken."""
        self.port = port
        self.name = name or port.url
        echo = getattr(port, "echo", "detect")
        self.core = BusCore(port.settings, name=self.name, echo=echo, allow_mixed=allow_mixed)
        self._clock = clock
        self._loop: asyncio.AbstractEventLoop | None = None
        self._timer: timers.BusTimer | None = None
        self._executing: list[CoreCommand] | None = None
        """Commands that are being executed; the execution of one may append others."""
        self._trace_sinks: list[Callable[[TraceEvent], None]] = []
        self._reopening: asyncio.Task[None] | None = None
        self._pending_reader = port if isinstance(port, PendingReader) else None
        self._pausable_port = port if isinstance(port, PausableReader) else None
        self._read_at = inf
        """Monotonic seconds until which received bytes wait in the kernel: the reply may be complete then."""
        self._spins_gaps = self._spinning = False
        self._pauses_reader = False

    # --- open and close ------------------------------------------------------------------------------------------

    async def open(self) -> None:
        """Open the port and start. Raises PortUnavailable with the reason and the remedy."""
        if self._loop is not None:
            return
        loop = asyncio.get_running_loop()
        loop_timers = timers.acquire(loop)
        try:
            await self.port.open(self)
        except BaseException as error:
            timers.release(loop)
            if isinstance(error, DrivebusError) or not isinstance(error, Exception):
                raise
            raise PortUnavailable("ports.failed", port=self.port.url, reason=SystemReason(error)) from error
        self._loop = loop
        self._clock = self._clock or loop_timers.now
        character_s = self.core.character_s
        self._timer = loop_timers.create_timer(
            self._on_timer, hides_wake_up=character_s < HIDDEN_WAKE_UP_MAX_CHARACTER_S
        )
        fast = character_s < FAST_BUS_CHARACTER_S
        self._spins_gaps = loop_timers.precise and self._pausable_port is not None and fast
        self._pauses_reader = self._pausable_port is not None and not fast
        self._on_port_open()

    async def close(self) -> None:
        """Stop and close the port; pending requests fail with PortLost. Idempotent."""
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

    @property
    def is_open(self) -> bool:
        """Whether the port is open now. A lost port is opened again automatically."""
        return self.core.is_open

    @property
    def port_opened_at(self) -> float | None:
        """Monotonic second of the last opening of the port, None while it is not open. Older values may be wrong."""
        return self.core.opened_at if self.core.is_open else None

    @property
    def is_closed(self) -> bool:
        """Whether the bus was not opened yet, or closed by ``close``; then no port is opened automatically."""
        return self._loop is None

    @property
    def settings(self) -> SerialSettings:
        """Baud rate and character format."""
        return self.core.settings

    @property
    def overdue_s(self) -> float:
        """Seconds by which the timer of the bus is overdue; more than a moment means that the event loop hangs."""
        return 0.0 if self.core.wake_at is None else max(0.0, self.now() - self.core.wake_at)

    def now(self) -> float:
        """Return monotonic seconds, the time base of this bus. On Linux they go on while the system is suspended."""
        if self._clock is not None:
            return self._clock()
        return timers.loop_now(asyncio.get_running_loop())

    # --- stations ------------------------------------------------------------------------------------------------

    def add_station(self, config: StationConfig) -> None:
        """Register a station. Raises ConfigurationError: address taken or broadcast, or protocols that must not mix."""
        self.core.registry.add(config)

    def remove_station(self, address: int) -> None:
        """Remove a station; its polls end and its queued requests fail. Raises KeyError."""
        self._perform(self.core.remove_station(address, self.now()))

    def presence(self, address: int) -> Presence:
        """Return whether a station replies. Raises KeyError for an address that is not registered."""
        return self.core.presence(address)

    def unusable_reply(self, address: int) -> Exception | None:
        """Return what a station that is not online sends in place of a reply, None for silence. Raises KeyError."""
        return self.core.unusable_reply(address)

    def contact_losses(self, address: int) -> int:
        """Return how often the port was lost, or a reply came after 10 s of silence or 2 minutes without request.

        Another drive, or one with other settings, may answer at the address since then. Raises KeyError.
        """
        return self.core.stations[address].contact_losses

    def health(self, address: int) -> StationHealth:
        """Return presence, error rates, foreign master, duplicate address. Raises KeyError: address not registered."""
        return self.core.health(address, self.now())

    @property
    def foreign_master(self) -> bool:
        """Whether another master has sent requests on this bus within the last minute."""
        return self.core.unsolicited.has_foreign_master(self.now())

    def stop_epoch(self, address: int) -> int:
        """Return the stop epoch of this station: its stops, port losses and removals so far. A permit of an earlier
        epoch is void. Raises KeyError."""
        return self.core.stations[address].stop_epoch

    def motions_sent(self, address: int) -> int:
        """Return how many frames were sent to this station that may move its motor. Raises KeyError."""
        return self.core.stations[address].motions_sent

    def inhibit_start(self, addresses: Iterable[int] | None = None) -> None:
        """Refuse every frame that may move a motor of these stations (None: all) until ``release_start``.

        ``drives`` refuses setpoints, resets and parameter writes then too.
        """
        self.core.registry.set_start_inhibit(addresses, inhibited=True)

    def release_start(self, addresses: Iterable[int] | None = None) -> None:
        """Reset the start inhibit: motion is permitted again, and no motor starts by itself."""
        self.core.registry.set_start_inhibit(addresses, inhibited=False)

    def start_inhibited(self, address: int) -> bool:
        """Return whether a start inhibit applies to this station. Raises KeyError."""
        return self.core.stations[address].start_inhibited

    def withdraw_commands(self, address: int, error: Exception) -> None:
        """Fail the commands of this station that have not been sent yet with this error; reads and stops go on.

        Raises KeyError.
        """
        self._perform(self.core.withdraw_commands(address, error, self.now()))

    # --- traffic -------------------------------------------------------------------------------------------------

    async def transact(self, bus_request: BusRequest) -> BusResult:
        """Perform one transaction; a failure is ``result.error``. Raises ValueError for a request out of range.

        Cancelled while it waits in a queue, it is never sent; while its frame is on the wire, its result is dropped.
        """
        future = TransactionFuture(loop=self._loop)
        self._perform(self.core.submit(bus_request, future, self.now()))
        try:
            return await future
        except asyncio.CancelledError:
            self._perform(self.core.cancel(future, self.now()))
            raise

    def submit(self, bus_request: BusRequest) -> asyncio.Future[BusResult]:
        """Queue one transaction at once and return the future of its result. Raises ValueError as ``transact``."""
        future: asyncio.Future[BusResult] = (self._loop or asyncio.get_running_loop()).create_future()
        self._perform(self.core.submit(bus_request, future, self.now()))
        return future

    def is_queued(self, submitted: asyncio.Future[BusResult]) -> bool:
        """Return whether a submitted request has not been sent yet, or waits to be sent once more."""
        return self.core.scheduler.is_queued(submitted)

    def start_polling(
        self, address: int, polls: Sequence[Poll], on_result: Callable[[BusResult], None]
    ) -> PollSubscription:
        """Send these polls until cancelled; ``on_result`` gets each result. Raises KeyError, ValueError."""
        subscription = PollSubscription(self._stop_polling, self._make_polls_due, on_result)
        self._perform(self.core.start_polling(address, polls, subscription, self.now()))
        return subscription

    def _stop_polling(self, subscription: PollSubscription) -> None:
        self._perform(self.core.stop_polling(subscription, self.now()))

    def _make_polls_due(self, subscription: PollSubscription, requests: Collection[Any]) -> None:
        self._perform(self.core.make_polls_due(subscription, requests, self.now()))

    def statistics(self) -> BusStatistics:
        """Return load, rates, reply times, errors and bytes, of the bus and of each station."""
        return self.core.statistics(self.now())

    def trace(self, sink: Callable[[TraceEvent], None]) -> Callable[[], None]:
        """Pass every frame on the wire to ``sink``; return the function that ends it."""
        self._trace_sinks.append(sink)
        self.core.tracing = True
        return lambda: self._untrace(sink)

    def _untrace(self, sink: Callable[[TraceEvent], None]) -> None:
        if sink in self._trace_sinks:
            self._trace_sinks.remove(sink)
        self.core.tracing = bool(self._trace_sinks)

    # --- port ----------------------------------------------------------------------------------------------------

    def data_received(self, data: bytes, line_errors: int = 0) -> None:
        """Handle received bytes."""
        assert self._clock is not None
        self._perform(self.core.on_data(data, self._clock(), line_errors))

    def port_lost(self, error: PortLost) -> None:
        """Handle the loss of the port: pending requests fail, and opening it again begins at once."""
        if self._loop is None or not self.core.is_open:
            return
        assert self._clock is not None
        self._perform(self.core.on_port_lost(error, self._clock()))
        if self._reopening is None or self._reopening.done():
            self._reopening = self._loop.create_task(self._reopen(), name=f"reopen {self.name}")

    async def _reopen(self) -> None:
        """Try to open the port until it is open and not lost by its first frame."""
        while True:
            await self._close_port()  # the rest of the earlier opening
            try:
                await self.port.open(self)
            except DrivebusError:  # not there yet, or in use: the next ``open`` of a user reports why
                pass
            except Exception as error:  # a driver in an unforeseen state must not prevent every stop to come
                self._report(f"opening bus {self.name} again failed", error)
            else:
                self._on_port_open()
            if self.core.is_open:
                return
            await asyncio.sleep(REOPEN_INTERVAL_S)

    async def _close_port(self) -> None:
        """Close the port; a failure is only reported."""
        try:
            await self.port.close()
        except Exception as error:
            self._report(f"closing bus {self.name} failed", error)

    def _on_port_open(self) -> None:
        self.core.has_line_timing = self.port.capabilities.has_line_timing
        self.core.learns_delays = self._pauses_reader
        assert self._clock is not None
        self._perform(self.core.on_port_open(self._clock()))

    # --- time ----------------------------------------------------------------------------------------------------

    def _on_timer(self) -> None:
        """Handle the timer after reading the bytes that have arrived before it."""
        assert self._clock is not None
        if self._pending_reader is not None:
            self._pending_reader.read_pending()
        now = self._clock()
        if self._is_due(now):
            if self._pending_reader is None and self.core.transaction is not None:
                self._loop.call_soon(self._on_timer_after_readers)  # type: ignore[union-attr]
                return
            self._perform(self.core.on_timer(now))
        else:
            self._schedule_next()

    def _on_timer_after_readers(self) -> None:
        """Serve the timer after the readers that were ready when it fired."""
        assert self._clock is not None
        now = self._clock()
        if self._is_due(now):
            self._perform(self.core.on_timer(now))
        else:
            self._arm_timer()

    def _is_due(self, now: float) -> bool:
        return self.core.wake_at is not None and now >= self.core.wake_at

    def _spin_gap(self) -> None:
        """Wait in a loop for a gap that is over before a timer could be set."""
        assert self._clock is not None and self._pausable_port is not None
        self._spinning = True
        while (when := self.core.wake_at) is not None and when <= self._clock() + SPIN_THRESHOLD_S:
            timers.busy_wait(self._clock, when)
            self._pausable_port.read_pending()
            if self.core.wake_at == when:
                self._perform(self.core.on_timer(self._clock()))
        self._spinning = False

    def _pause_or_resume_reader(self) -> None:
        """Leave bytes in the kernel until they may complete the reply; read all others as they come."""
        assert self._pausable_port is not None
        transaction = self.core.transaction
        self._read_at = inf
        if transaction is not None and transaction.message is not None:
            return  # the timer reads whatever follows the reply
        useful_at = None if transaction is None else transaction.earliest_useful_at()
        if useful_at is None or self._clock is None or useful_at <= self._clock() + MIN_READER_PAUSE_S:
            self._pausable_port.resume_reading()
        else:
            self._read_at = useful_at
            self._pausable_port.pause_reading()

    def _arm_timer(self) -> None:
        if self._timer is None:
            return
        wake_at = self.core.wake_at
        when = self._read_at if wake_at is None or wake_at > self._read_at else wake_at
        if when != self._timer.when:
            self._timer.set(None if when == inf else when)

    # --- commands of the core ------------------------------------------------------------------------------------

    def _perform(self, commands: list[CoreCommand]) -> None:
        """Execute commands in order, also those that their execution causes.

        Frames leave first: their permits were checked at this very moment, and a sink may take its time.
        """
        if self._executing is not None:
            self._executing += commands
            self._send_frames(commands)
            return
        if commands:
            self._executing = commands
            try:
                self._send_frames(tuple(commands))
                for command in commands:
                    if type(command) is DeliverResult:
                        token = command.token
                        if type(token) is PollSubscription:
                            self._notify(token.on_result, command.result)
                        elif not token.done():
                            token.set_result(command.result)
                    elif type(command) is EmitTrace:
                        for sink in tuple(self._trace_sinks):
                            self._notify(sink, command.event)
            finally:
                self._executing = None
        if not self._spinning:
            self._schedule_next()

    def _schedule_next(self) -> None:
        if self._spins_gaps:
            self._spin_gap()
        elif self._pauses_reader:
            self._pause_or_resume_reader()
        self._arm_timer()

    def _send_frames(self, commands: Sequence[CoreCommand]) -> None:
        for command in commands:
            if type(command) is Send:
                try:
                    self.port.write(command.data)
                except PortLost as error:
                    self.port_lost(error)
                except Exception as error:  # a bus that waited for ever would send no stop either
                    self._report(f"writing to bus {self.name} failed", error)
                    self.port_lost(PortLost("ports.lost", port=self.name, reason=SystemReason(error)))

    def _notify(self, sink: Callable[[Any], None], value: Any) -> None:
        """Call a sink; its failure is reported and does not stop the bus."""
        try:
            sink(value)
        except Exception as error:
            self._report(f"a sink of bus {self.name} failed", error)

    def _report(self, message: str, error: Exception) -> None:
        """Report an unexpected failure to the exception handler of the loop."""
        loop = self._loop or asyncio.get_running_loop()
        loop.call_exception_handler({"message": message, "exception": error})
