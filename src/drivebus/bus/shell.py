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
from drivebus.bus.core import BusCore
from drivebus.bus.effects import Act, Done, Traced, Transmit, WakeAt
from drivebus.bus.trace import TraceEvent
from drivebus.errors import DrivebusError, PortLost
from drivebus.message import Answer
from drivebus.ports.port import Port, Quietable
from drivebus.seams import Clock

REOPEN_S = 0.4
"""Pause between attempts to open a lost port: polling is back within 2 s of the device (G09)."""
STAY_S = 40e-6
"""A wait shorter than this is waited out on the spot: setting a timer and sleeping takes longer."""
FAST_CHARACTER_S = 30e-6
"""Lines faster than this (350,000 baud) have gaps that are waited out; on slower ones the reader is put to sleep."""
WORTH_WAITING_S = 0.001
"""A reader is put to sleep only where it saves more than this: falling quiet costs a system call."""


class Watch:
    """A set of polls of one station; ``cancel`` ends it."""

    __slots__ = ("_end", "sink")

    def __init__(self, end: Callable[[Watch], None], sink: Callable[[Answer], None]) -> None:
        self._end = end
        self.sink = sink

    def cancel(self) -> None:
        """No more polls, no more answers. Idempotent."""
        self._end(self)


class Shell:
    """Port, clock, alarm and core of one bus."""

    def __init__(self, port: Port, name: str, allow_mixed: bool, clock: Clock | None) -> None:
        self.port = port
        self.name = name or port.url
        echo = getattr(port, "echo", "detect")
        self.core = BusCore(port.settings, name=self.name, echo=echo, allow_mixed=allow_mixed)
        self._clock = clock
        self._loop: asyncio.AbstractEventLoop | None = None
        self._alarm: timers.Alarm | None = None
        self._acts: deque[Act] = deque()
        self._performing = False
        self._tracers: list[Callable[[TraceEvent], None]] = []
        self._reopening: asyncio.Task[None] | None = None
        self._quiet = port if isinstance(port, Quietable) else None
        self._listen_at = inf
        self._wake_at: float | None = None
        self._stays = self._staying = False
        self._hushes = False

    def _begin(self, loop: asyncio.AbstractEventLoop, timer: timers.PreciseTimer) -> None:
        """The port has been opened for the first time."""
        self._loop = loop
        self._clock = self._clock or timer.now
        self._alarm = timer.alarm(self._woke)
        fast = self.core.line.character_s < FAST_CHARACTER_S
        self._stays = timer.precise and self._quiet is not None and fast
        self._hushes = self._quiet is not None and not fast
        self._opened()

    # --- Receiver ----------------------------------------------------------------------------------------------

    def data_received(self, data: bytes, marks: int = 0) -> None:
        """From the port: bytes came."""
        assert self._clock is not None
        self._perform(self.core.received(data, self._clock(), marks))

    def port_lost(self, error: PortLost) -> None:
        """From the port: it is gone. Everything pending fails; opening it again begins at once."""
        if self._loop is None or not self.core.is_open:
            return
        assert self._clock is not None
        self._perform(self.core.lost(error, self._clock()))
        if self._reopening is None or self._reopening.done():
            self._reopening = self._loop.create_task(self._reopen(), name=f"reopen {self.name}")

    async def _reopen(self) -> None:
        """At once, then again and again: until it is open, and stays so through its first frame."""
        while True:
            await self._let_go()  # whatever is left of the old opening
            try:
                await self.port.open(self)
            except DrivebusError:  # not there yet, or not ours yet: why is the next opener's to read
                pass
            except Exception as error:  # a driver in a state that nobody foresaw: no reason to lose every stop to come
                self._complain(f"opening bus {self.name} again failed", error)
            else:
                self._opened()
            if self.core.is_open:
                return
            await asyncio.sleep(REOPEN_S)

    async def _let_go(self) -> None:
        """Close the port, as well as it can be closed: no port's failure there is anybody's to handle."""
        try:
            await self.port.close()
        except Exception as error:
            self._complain(f"closing bus {self.name} failed", error)

    def _opened(self) -> None:
        self.core.paced = self.port.capabilities.paced
        assert self._clock is not None
        self._perform(self.core.opened(self._clock()))

    # --- time --------------------------------------------------------------------------------------------------

    def _woke(self) -> None:
        """The alarm: hear first what the port still holds, so that no byte in the kernel is overlooked."""
        assert self._clock is not None
        if self._quiet is not None:
            self._listen_at = inf
            self._quiet.quiet_until(0.0)
        now = self._clock()
        if self._wake_at is not None and now >= self._wake_at:
            if self._quiet is None and self.core.flight is not None:
                self._loop.call_soon(self._woke_after_readers)  # type: ignore[union-attr]
                return
            self._perform(self.core.woke(now))
        else:
            self._set_alarm()

    def _soon(self) -> None:
        """A gap of a few characters on a fast line is over before a timer could be set: stay for it."""
        assert self._clock is not None and self._quiet is not None
        self._staying = True
        while (when := self._wake_at) is not None and when <= self._clock() + STAY_S:
            timers.spin(self._clock, when)
            self._quiet.quiet_until(0.0)
            if self._wake_at == when:
                self._perform(self.core.woke(self._clock()))
        self._staying = False

    def _woke_after_readers(self) -> None:
        """Readers that were ready when the alarm rang have run by now."""
        assert self._clock is not None
        if self._wake_at is not None and self._clock() >= self._wake_at:
            self._perform(self.core.woke(self._clock()))
        else:
            self._set_alarm()

    def _hush(self) -> None:
        """No byte that comes before ``useful_at`` can complete the reply: let them wait in the kernel."""
        flight = self.core.flight
        if flight is None or self._clock is None:
            return
        useful_at = flight.useful_at()
        if useful_at is not None and self._quiet is not None and useful_at > self._clock() + WORTH_WAITING_S:
            self._listen_at = useful_at
            self._quiet.quiet_until(inf)

    def _set_alarm(self) -> None:
        if self._alarm is None:
            return
        when = self._listen_at if self._wake_at is None else min(self._wake_at, self._listen_at)
        if when != self._alarm.when:
            self._alarm.set(None if when == inf else when)

    # --- effects -----------------------------------------------------------------------------------------------

    def _perform(self, acts: list[Act]) -> None:
        """Do what the core says, in order, also where doing it makes the core say more.

        A frame leaves first: its permit was checked at this very moment, and a sink may take its time (I1).
        """
        if self._performing:
            self._acts.extend(acts)
            self._send(acts)
            return
        self._performing = True
        try:
            self._send(acts)
            self._do(acts)
            while self._acts:
                self._do((self._acts.popleft(),))
        finally:
            self._performing = False
        if not self._staying:
            self._settle()

    def _settle(self) -> None:
        """All has been done: now the next moment to look."""
        if self._stays:
            self._soon()
        elif self._hushes:
            self._hush()
        self._set_alarm()

    def _send(self, acts: list[Act]) -> None:
        for act in acts:
            if type(act) is Transmit:
                try:
                    self.port.write(act.data)
                except PortLost as error:
                    self.port_lost(error)
                except Exception as error:  # no port should: but a bus that waits for ever sends no stop either
                    self._complain(f"writing to bus {self.name} failed", error)
                    self.port_lost(PortLost("ports.lost", port=self.name, reason=str(error)))

    def _do(self, acts: Iterable[Act]) -> None:
        for act in acts:
            if type(act) is Done:
                if type(act.token) is Watch:
                    self._tell(act.token.sink, act.answer)
                elif not act.token.done():
                    act.token.set_result(act.answer)
            elif type(act) is WakeAt:
                self._wake_at = act.when
            elif type(act) is Traced:
                for tracer in tuple(self._tracers):
                    self._tell(tracer, act.event)

    def _tell(self, sink: Callable[[Any], None], value: Any) -> None:
        """A sink that fails is the sink's problem: the bus goes on, the loop's handler is told."""
        try:
            sink(value)
        except Exception as error:
            self._complain(f"a sink of bus {self.name} failed", error)

    def _complain(self, message: str, error: Exception) -> None:
        loop = self._loop or asyncio.get_running_loop()
        loop.call_exception_handler({"message": message, "exception": error})
