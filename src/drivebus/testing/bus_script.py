"""Scripted bus in virtual time: ``BusScript`` runs the engine without a loop, ``ScriptedPort`` serves a whole ``Bus``.

A *wire* is a function: (frame, second of its last bit) → the reply, as (second, bytes) pairs.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Iterable, Sequence
from heapq import heappop, heappush
from typing import Any

from drivebus.bus.commands import CoreCommand, DeliverResult, Send
from drivebus.bus.core import BusCore
from drivebus.bus.messages import BusRequest, BusResult
from drivebus.bus.prepared_request import Poll
from drivebus.bus.trace import TraceEvent
from drivebus.errors import PortLost, PortUnavailable
from drivebus.serial_settings import SerialSettings
from drivebus.types import Capabilities, EchoSetting, Receiver

Wire = Callable[[bytes, float], Iterable[tuple[float, bytes]]]


def silent_wire(frame: bytes, ended_at: float) -> Iterable[tuple[float, bytes]]:
    """Answer nothing, as a wire without a station."""
    return ()


class BusScript:
    """Script of one bus engine, which records ``sent`` (time, bytes), ``results`` by token, and ``traced``."""

    def __init__(self, core: BusCore, wire: Wire = silent_wire, *, start: float = 0.0) -> None:
        self.core = core
        self.wire = wire
        self.now = start
        self.sent: list[tuple[float, bytes]] = []
        self.results: dict[Any, list[BusResult]] = {}
        self.traced: list[TraceEvent] = []
        self.recording = True
        """Off for long runs."""
        self._incoming: list[tuple[float, int, bytes, int]] = []
        self._count = 0
        self._perform(core.on_port_open(start))

    def submit(self, bus_request: BusRequest, token: Any = "request") -> None:
        """Submit a request; its result is in ``results`` under ``token``."""
        self._perform(self.core.submit(bus_request, token, self.now))

    def start_polling(self, address: int, polls: Sequence[Poll], token: Any = "polls") -> None:
        """Start polls; their results are in ``results`` under ``token``."""
        self._perform(self.core.start_polling(address, polls, token, self.now))

    def make_polls_due(self, requests: Collection[Any], token: Any = "polls") -> None:
        """Make the polls of these requests due now."""
        self._perform(self.core.make_polls_due(token, requests, self.now))

    def receive(self, data: bytes, *, at: float | None = None, line_errors: int = 0) -> None:
        """Let the bus receive bytes at that second, now if None."""
        self._count += 1
        heappush(self._incoming, (self.now if at is None else at, self._count, data, line_errors))

    def lose_port(self, error: PortLost) -> None:
        """Lose the port; bytes still to be received are lost too."""
        self._incoming.clear()
        self._perform(self.core.on_port_lost(error, self.now))

    def reopen(self) -> None:
        """Open the port again."""
        self._perform(self.core.on_port_open(self.now))

    def run_until(self, when: float) -> None:
        """Run everything that happens up to and at that second."""
        while (at := self._next_at()) is not None and at <= when:
            self._step(at)
        self.now = max(self.now, when)

    def run(self) -> None:
        """Run until nothing more can happen (never, with polls)."""
        while (at := self._next_at()) is not None:
            self._step(at)

    def result(self, token: Any = "request") -> BusResult:
        """Run until the request of this token has its result, and return it."""
        while token not in self.results:
            at = self._next_at()
            assert at is not None, f"nothing more can happen and {token!r} has no result"
            self._step(at)
        return self.results[token][-1]

    @property
    def frames(self) -> list[bytes]:
        return [frame for _, frame in self.sent]

    def _next_at(self) -> float | None:
        coming = self._incoming[0][0] if self._incoming else None
        wake_at = self.core.wake_at
        if coming is None or (wake_at is not None and wake_at < coming):
            return wake_at
        return coming

    def _step(self, at: float) -> None:
        """Run one event; bytes of the same second as the timer come first, as with the reader of a real bus."""
        self.now = max(self.now, at)
        if self._incoming and self._incoming[0][0] <= at:
            _, _, data, line_errors = heappop(self._incoming)
            self._perform(self.core.on_data(data, self.now, line_errors))
        else:
            self._perform(self.core.on_timer(self.now))

    def _perform(self, commands: list[CoreCommand]) -> None:
        for command in commands:
            if isinstance(command, Send):
                self._send(command.data)
            elif isinstance(command, DeliverResult):
                if self.recording:
                    self.results.setdefault(command.token, []).append(command.result)
            else:
                self.traced.append(command.event)

    def _send(self, frame: bytes) -> None:
        if self.recording:
            self.sent.append((self.now, frame))
        for at, data in self.wire(frame, self.now + self.core.settings.seconds(len(frame))):
            self.receive(data, at=at)


class ScriptedPort:
    """A port on a wire, with line timing by default, so that durations are exact."""

    def __init__(
        self,
        wire: Wire,
        settings: SerialSettings | None = None,
        *,
        has_line_timing: bool = True,
        echo: EchoSetting = "off",
    ) -> None:
        self.wire = wire
        self.settings = settings or SerialSettings()
        self.capabilities = Capabilities(has_line_timing=has_line_timing)
        self.echo: EchoSetting = echo
        self.identity = "scripted"
        self.url = "scripted://"
        self.sent: list[tuple[float, bytes]] = []
        self.plugged = True
        self.openings = 0
        self._receiver: Receiver | None = None

    async def open(self, receiver: Receiver) -> None:
        """Raises PortUnavailable while unplugged."""
        if not self.plugged:
            raise PortUnavailable("ports.memory_unplugged", port=self.url)
        self.openings += 1
        self._receiver = receiver

    def write(self, data: bytes, /) -> None:
        """Raises PortLost where the port is not open."""
        if self._receiver is None:
            raise PortLost("ports.not_open", port=self.url)
        loop = asyncio.get_running_loop()
        self.sent.append((loop.time(), data))
        opening = self.openings
        for at, reply in self.wire(data, loop.time() + self.settings.seconds(len(data))):
            loop.call_at(at, self._deliver, reply, opening)

    async def close(self) -> None:
        self._receiver = None

    def unplug(self) -> None:
        """Lose the device: the receiver gets ``port_lost``, opening fails until ``plugged`` is set again."""
        self.plugged = False
        receiver, self._receiver = self._receiver, None
        if receiver is not None:
            receiver.port_lost(PortLost("ports.lost", port=self.url, reason=PortLost("ports.pulled")))

    def _deliver(self, data: bytes, opening: int) -> None:
        if self._receiver is not None and opening == self.openings:
            self._receiver.data_received(data)
