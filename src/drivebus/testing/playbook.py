"""Conversations as scripts: events in, effects out, in virtual time. ``Playbook`` drives the pure core without any
loop; ``ScriptedPort`` plays the same wire to a whole ``Bus`` under ``virtual.run``.

A *wire* is a function: (frame, second of its last bit) → what comes back, as (second, bytes) pairs.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Sequence
from heapq import heappop, heappush
from typing import Any

from drivebus.bus.core import BusCore
from drivebus.bus.effects import Act, Done, Traced, Transmit
from drivebus.bus.planner import Poll
from drivebus.bus.trace import TraceEvent
from drivebus.errors import PortLost, PortUnavailable
from drivebus.line import LineSettings
from drivebus.message import Answer, Ask
from drivebus.ports.port import Capabilities, Echo, Receiver

Wire = Callable[[bytes, float], Iterable[tuple[float, bytes]]]


def silence(frame: bytes, ended_at: float) -> Iterable[tuple[float, bytes]]:
    """A wire with nobody on it."""
    return ()


class Playbook:
    """Plays one bus core and writes down all that it does: ``sent`` (time, bytes), ``answers`` by token, ``traced``."""

    def __init__(self, core: BusCore, wire: Wire = silence, *, start: float = 0.0) -> None:
        self.core = core
        self.wire = wire
        self.now = start
        self.sent: list[tuple[float, bytes]] = []
        self.answers: dict[Any, list[Answer]] = {}
        self.traced: list[TraceEvent] = []
        self.keep = True
        """Write down; off for long runs."""
        self._wake: float | None = None
        self._coming: list[tuple[float, int, bytes, int]] = []
        self._count = 0
        self._perform(core.opened(start))

    def ask(self, ask: Ask, token: Any = "ask") -> None:
        self._perform(self.core.submit(ask, token, self.now))

    def watch(self, address: int, polls: Sequence[Poll], token: Any = "watch") -> None:
        self._perform(self.core.watch(address, polls, token, self.now))

    def hear(self, data: bytes, *, at: float | None = None, marks: int = 0) -> None:
        """These bytes come at that second (now, if none is given)."""
        self._count += 1
        heappush(self._coming, (self.now if at is None else at, self._count, data, marks))

    def lose(self, error: PortLost) -> None:
        self._coming.clear()
        self._perform(self.core.lost(error, self.now))

    def reopen(self) -> None:
        self._perform(self.core.opened(self.now))

    def until(self, when: float) -> None:
        """Play everything that happens up to and at that second."""
        while (at := self._next()) is not None and at <= when:
            self._step(at)
        self.now = max(self.now, when)

    def play(self) -> None:
        """Play until nothing more can happen (never, with polls)."""
        while (at := self._next()) is not None:
            self._step(at)

    def answer(self, token: Any = "ask") -> Answer:
        """Play until this ask has its answer."""
        while token not in self.answers:
            at = self._next()
            assert at is not None, f"nothing more can happen and {token!r} has no answer"
            self._step(at)
        return self.answers[token][-1]

    @property
    def frames(self) -> list[bytes]:
        return [frame for _, frame in self.sent]

    def _next(self) -> float | None:
        coming = self._coming[0][0] if self._coming else None
        if coming is None or (self._wake is not None and self._wake < coming):
            return self._wake
        return coming

    def _step(self, at: float) -> None:
        """Bytes that come at the very second of a wake are heard first, as a real master's reader would."""
        self.now = max(self.now, at)
        if self._coming and self._coming[0][0] <= at:
            _, _, data, marks = heappop(self._coming)
            self._perform(self.core.received(data, self.now, marks))
        else:
            self._wake = None
            self._perform(self.core.woke(self.now))

    def _perform(self, acts: list[Act]) -> None:
        for act in acts:
            if isinstance(act, Transmit):
                self._send(act.data)
            elif isinstance(act, Done):
                if self.keep:
                    self.answers.setdefault(act.token, []).append(act.answer)
            elif isinstance(act, Traced):
                self.traced.append(act.event)
            else:
                self._wake = act.when

    def _send(self, frame: bytes) -> None:
        if self.keep:
            self.sent.append((self.now, frame))
        for at, data in self.wire(frame, self.now + self.core.line.seconds(len(frame))):
            self.hear(data, at=at)


class ScriptedPort:
    """A Port whose far side is a wire. Paced by default, so that durations are exact."""

    def __init__(
        self, wire: Wire, settings: LineSettings | None = None, *, paced: bool = True, echo: Echo = "off"
    ) -> None:
        self.wire = wire
        self.settings = settings or LineSettings()
        self.capabilities = Capabilities(paced=paced)
        self.echo: Echo = echo
        self.identity = "scripted"
        self.url = "scripted://"
        self.sent: list[tuple[float, bytes]] = []
        self.plugged = True
        self.openings = 0
        self._receiver: Receiver | None = None

    async def open(self, receiver: Receiver) -> None:
        """Raises PortUnavailable while unplugged."""
        if not self.plugged:
            raise PortUnavailable("ports.memory-unplugged", port=self.url)
        self.openings += 1
        self._receiver = receiver

    def write(self, data: bytes, /) -> None:
        """Raises PortLost where the port is not open."""
        if self._receiver is None:
            raise PortLost("ports.not-open", port=self.url)
        loop = asyncio.get_running_loop()
        self.sent.append((loop.time(), data))
        opening = self.openings
        for at, reply in self.wire(data, loop.time() + self.settings.seconds(len(data))):
            loop.call_at(at, self._arrive, reply, opening)

    async def close(self) -> None:
        self._receiver = None

    def unplug(self) -> None:
        """The device is gone: the receiver is told, opening fails until ``plugged`` is set again."""
        self.plugged = False
        receiver, self._receiver = self._receiver, None
        if receiver is not None:
            receiver.port_lost(PortLost("ports.lost", port=self.url, reason="unplugged"))

    def _arrive(self, data: bytes, opening: int) -> None:
        if self._receiver is not None and opening == self.openings:
            self._receiver.data_received(data)
