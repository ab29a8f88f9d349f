"""The shell around the pure core: tells it what happened, does what it says, keeps the time and the port.

No rule of the bus lives here, and nothing that a user calls: that is ``master``.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterable
from math import inf
from typing import Any

from drivebus.bus import timer as timers
from drivebus.bus.commands import CoreCommand, DeliverResult, EmitTrace, Send, SetTimer
from drivebus.bus.core import BusCore
from drivebus.bus.trace import TraceEvent
from drivebus.clock import Clock
from drivebus.errors import DrivebusError, PortLost
from drivebus.ports.base import PausableReader, Port
from drivebus.protocols.codec import BusResult

REOPEN_INTERVAL_S = 0.4
"""Pause between attempts to open a lost port: polling is back within 2 s of the device (G09)."""
SPIN_THRESHOLD_S = 40e-6
"""A wait shorter than this is waited out on the spot: setting a timer and sleeping takes longer."""
FAST_BUS_CHARACTER_S = 30e-6
"""Lines faster than this (350,000 baud) have gaps that are waited out; on slower ones the reader is put to sleep."""
MIN_READER_PAUSE_S = 0.001
"""A reader is put to sleep only where it saves more than this: falling quiet costs a system call."""


class PollSubscription:
    """A set of polls of one station; ``cancel`` ends it."""

    __slots__ = ("_stop", "on_result")

    def __init__(self, stop: Callable[[PollSubscription], None], on_result: Callable[[BusResult], None]) -> None:
        self._stop = stop
        self.on_result = on_result

    def cancel(self) -> None:
        """No more polls, no more answers. Idempotent."""
        self._stop(self)


class Shell:
    """Port, clock, alarm and core of one bus."""

    def __init__(self, port: Port, name: str, allow_mixed: bool, clock: Clock | None) -> None:
        self.port = port
        self.name = name or port.url
        echo = getattr(port, "echo", "detect")
        self.core = BusCore(port.settings, name=self.name, echo=echo, allow_mixed=allow_mixed)
        self._clock = clock
        self._loop: asyncio.AbstractEventLoop | None = None
        self._timer: timers.BusTimer | None = None
        self._pending_commands: deque[CoreCommand] = deque()
        self._performing = False
        self._trace_sinks: list[Callable[[TraceEvent], None]] = []
        self._reopening: asyncio.Task[None] | None = None
        self._pausable_port = port if isinstance(port, PausableReader) else None
        self._resume_reading_at = inf
        self._timer_at: float | None = None
        self._spins_gaps = self._spinning = False
        self._pauses_reader = False

    def _start(self, loop: asyncio.AbstractEventLoop, timer: timers.TimerQueue) -> None:
        """The port has been opened for the first time."""
        self._loop = loop
        self._clock = self._clock or timer.now
        self._timer = timer.create_timer(self._on_timer)
        fast = self.core.settings.character_s < FAST_BUS_CHARACTER_S
        self._spins_gaps = timer.precise and self._pausable_port is not None and fast
        self._pauses_reader = self._pausable_port is not None and not fast
        self._on_port_open()

    # --- Receiver ----------------------------------------------------------------------------------------------

    def data_received(self, data: bytes, line_errors: int = 0) -> None:
        """From the port: bytes came."""
        assert self._clock is not None
        self._perform(self.core.on_data(data, self._clock(), line_errors))

    def port_lost(self, error: PortLost) -> None:
        """From the port: it is gone. Everything pending fails; opening it again begins at once."""
        if self._loop is None or not self.core.is_open:
            return
        assert self._clock is not None
        self._perform(self.core.on_port_lost(error, self._clock()))
        if self._reopening is None or self._reopening.done():
            self._reopening = self._loop.create_task(self._reopen(), name=f"reopen {self.name}")

    async def _reopen(self) -> None:
        """At once, then again and again: until it is open, and stays so through its first frame."""
        while True:
            await self._close_port()  # whatever is left of the old opening
            try:
                await self.port.open(self)
            except DrivebusError:  # not there yet, or not ours yet: why is the next opener's to read
                pass
            except Exception as error:  # a driver in a state that nobody foresaw: no reason to lose every stop to come
                self._report(f"opening bus {self.name} again failed", error)
            else:
                self._on_port_open()
            if self.core.is_open:
                return
            await asyncio.sleep(REOPEN_INTERVAL_S)

    async def _close_port(self) -> None:
        """Close the port, as well as it can be closed: no port's failure there is anybody's to handle."""
        try:
            await self.port.close()
        except Exception as error:
            self._report(f"closing bus {self.name} failed", error)

    def _on_port_open(self) -> None:
        self.core.has_line_timing = self.port.capabilities.has_line_timing
        assert self._clock is not None
        self._perform(self.core.on_port_open(self._clock()))

    # --- time --------------------------------------------------------------------------------------------------

    def _on_timer(self) -> None:
        """The alarm: hear first what the port still holds, so that no byte in the kernel is overlooked."""
        assert self._clock is not None
        if self._pausable_port is not None:
            self._resume_reading_at = inf
            self._pausable_port.pause_until(0.0)
        now = self._clock()
        if self._timer_at is not None and now >= self._timer_at:
            if self._pausable_port is None and self.core.transaction is not None:
                self._loop.call_soon(self._on_timer_after_readers)  # type: ignore[union-attr]
                return
            self._perform(self.core.on_timer(now))
        else:
            self._arm_timer()

    def _spin_gap(self) -> None:
        """A gap of a few characters on a fast line is over before a timer could be set: stay for it."""
        assert self._clock is not None and self._pausable_port is not None
        self._spinning = True
        while (when := self._timer_at) is not None and when <= self._clock() + SPIN_THRESHOLD_S:
            timers.busy_wait(self._clock, when)
            self._pausable_port.pause_until(0.0)
            if self._timer_at == when:
                self._perform(self.core.on_timer(self._clock()))
        self._spinning = False

    def _on_timer_after_readers(self) -> None:
        """Readers that were ready when the alarm rang have run by now."""
        assert self._clock is not None
        if self._timer_at is not None and self._clock() >= self._timer_at:
            self._perform(self.core.on_timer(self._clock()))
        else:
            self._arm_timer()

    def _pause_reader(self) -> None:
        """No byte that comes before ``useful_at`` can complete the reply: let them wait in the kernel."""
        flight = self.core.transaction
        if flight is None or self._clock is None:
            return
        useful_at = flight.earliest_useful_at()
        if useful_at is not None and self._pausable_port is not None and useful_at > self._clock() + MIN_READER_PAUSE_S:
            self._resume_reading_at = useful_at
            self._pausable_port.pause_until(inf)

    def _arm_timer(self) -> None:
        if self._timer is None:
            return
        when = self._resume_reading_at if self._timer_at is None else min(self._timer_at, self._resume_reading_at)
        if when != self._timer.when:
            self._timer.set(None if when == inf else when)

    # --- effects -----------------------------------------------------------------------------------------------

    def _perform(self, commands: list[CoreCommand]) -> None:
        """Do what the core says, in order, also where doing it makes the core say more.

        A frame leaves first: its permit was checked at this very moment, and a sink may take its time (I1).
        """
        if self._performing:
            self._pending_commands.extend(commands)
            self._send_frames(commands)
            return
        self._performing = True
        try:
            self._send_frames(commands)
            self._execute(commands)
            while self._pending_commands:
                self._execute((self._pending_commands.popleft(),))
        finally:
            self._performing = False
        if not self._spinning:
            self._schedule_next()

    def _schedule_next(self) -> None:
        """All has been done: now the next moment to look."""
        if self._spins_gaps:
            self._spin_gap()
        elif self._pauses_reader:
            self._pause_reader()
        self._arm_timer()

    def _send_frames(self, commands: list[CoreCommand]) -> None:
        for act in commands:
            if type(act) is Send:
                try:
                    self.port.write(act.data)
                except PortLost as error:
                    self.port_lost(error)
                except Exception as error:  # no port should: but a bus that waits for ever sends no stop either
                    self._report(f"writing to bus {self.name} failed", error)
                    self.port_lost(PortLost("ports.lost", port=self.name, reason=str(error)))

    def _execute(self, commands: Iterable[CoreCommand]) -> None:
        for act in commands:
            if type(act) is DeliverResult:
                if type(act.token) is PollSubscription:
                    self._notify(act.token.on_result, act.result)
                elif not act.token.done():
                    act.token.set_result(act.result)
            elif type(act) is SetTimer:
                self._timer_at = act.when
            elif type(act) is EmitTrace:
                for tracer in tuple(self._trace_sinks):
                    self._notify(tracer, act.event)

    def _notify(self, sink: Callable[[Any], None], value: Any) -> None:
        """A sink that fails is the sink's problem: the bus goes on, the loop's handler is told."""
        try:
            sink(value)
        except Exception as error:
            self._report(f"a sink of bus {self.name} failed", error)

    def _report(self, message: str, error: Exception) -> None:
        loop = self._loop or asyncio.get_running_loop()
        loop.call_exception_handler({"message": message, "exception": error})
