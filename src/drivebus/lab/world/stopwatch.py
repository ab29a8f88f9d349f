"""Measures every stop of a stand on the copper: what went before it, and whether it came in time (I3, G06).

A stop must follow the frame on the wire, whatever that is: after the time that its drive may take to reply (by
``bounds``), the gap and nothing else. Where several drives are to be stopped, their stops take turns.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from drivebus.lab.bounds import Times
from drivebus.lab.manual import Does, request
from drivebus.lab.world.stand import Stand

TOLERANCE_S = 1e-3
"""G06, virtual."""
EPSILON_S = 1e-9


class Sent(NamedTuple):
    """A request of the host on the copper."""

    start: float
    end: float
    address: int
    does: Does
    data: bytes


@dataclass(slots=True)
class Waiting:
    """A stop that was wished and has not left yet."""

    address: int
    at: float
    due: float
    """By this second its first bit must be out."""
    turnaround: bool
    """A stop of all is on the wire, and nobody answers it (F10): its turnaround is no part of 5.1."""
    before: list[int] = field(default_factory=list)
    """Addresses that were stopped first: each other drive may be, once, and all of them by broadcasts."""
    babbled: bool = False
    """Somebody's late reply held it back."""


class StopWatch:
    """Watches one stand. ``told`` is called with each stop that left and with its frame."""

    def __init__(self, stand: Stand, told: Callable[[Waiting, Sent], None]) -> None:
        self.stand, self.told = stand, told
        self.times = Times(stand.kind, stand.bench.line)
        self.last: Sent | None = None
        self.stopped_at: dict[int, float] = {}
        """When the last stop left, by address."""
        self._waiting: list[Waiting] = []
        self._replies: deque[Any] = deque(maxlen=16)
        self._tap()

    def _tap(self) -> None:
        wire: Any = self.stand.bench.wire
        say = wire.say

        def on_say(talker: Any, data: bytes, *more: Any, **named: Any) -> Any:
            said = say(talker, data, *more, **named)
            if hasattr(talker, "hear"):
                address, does = request(self.stand.kind.model, self.stand.kind.encoding, data)
                self._sent(Sent(said.start, said.end, address, does, data))
            else:
                self._replies.append(said)
            return said

        wire.say = on_say

    def wished(self, address: int) -> None:
        """A stop of this drive is wished now (the broadcast address: of all)."""
        now = self.stand.loop.time()
        turnaround = self.last is not None and self.last.address == self.stand.kind.broadcast
        self._waiting.append(Waiting(address, now, self._free_at(now) + self.times.gap_s, turnaround))

    def _free_at(self, now: float) -> float:
        """When at the latest the frame on the wire is over."""
        if self.last is None:
            return now
        return max(now, self.last.end + self.times.limit_s(self.last.address, self.last.data))

    def _sent(self, sent: Sent) -> None:
        before, self.last = self.last, sent
        if sent.does is Does.STOP:
            self.stopped_at[sent.address] = sent.start
        babbled = before is not None and self._somebody_else(before, sent.start)
        for one in tuple(self._waiting):
            self._hold(one, sent, babbled)

    def _somebody_else(self, before: Sent, start: float) -> bool:
        """Was anything heard in the time that belonged to nobody any more?"""
        over = before.end + self.times.limit_s(before.address, before.data)
        return any(said.end > over and said.start < start for said in self._replies)

    def _hold(self, one: Waiting, sent: Sent, babbled: bool) -> None:
        late_s = sent.start - one.due - (self.times.babble_s if babbled else 0.0)
        if late_s > TOLERANCE_S:
            self._violation(f"G06 {sent.does} to {sent.address} left {late_s * 1000:.1f} ms later than a stop may", one)
        if sent.does is Does.STOP and sent.address == one.address:
            self._waiting.remove(one)
            one.babbled |= babbled
            self.told(one, sent)
            return
        one.due = sent.end + self.times.limit_s(sent.address, sent.data) + self.times.gap_s
        if sent.start <= one.at + EPSILON_S:
            one.turnaround |= sent.address == self.stand.kind.broadcast
            return
        if sent.does is not Does.STOP:
            self._violation(f"I3 {sent.does} to {sent.address} went before it", one)
        one.babbled |= babbled
        if sent.address in one.before and sent.address != self.stand.kind.broadcast:
            self._violation(f"I3 stops of {sent.address} went before it again and again", one)
        one.before.append(sent.address)

    def phase(self) -> str:
        """What is going on on the copper now, for the count of what was tried."""
        now, last = self.stand.loop.time(), self.last
        flight = self.stand.bus.core.flight
        what = "nothing" if flight is None else "a broadcast" if flight.job.broadcast else _what(flight.job)
        if last is None or flight is None:
            return "idle or in a gap"
        if now < last.end:
            return f"sending {what}"
        heard = any(said.start <= now < said.end for said in self._replies)
        return f"hearing the reply to {what}" if heard else f"waiting after {what}"

    def finish(self) -> None:
        """Nothing may wait any more."""
        for one in self._waiting:
            self._violation("G05 it was never sent", one)

    def _violation(self, text: str, one: Waiting) -> None:
        self.stand.witness.violation(f"{text}: stop of {one.address}, wished at {one.at:.6f}")


def _what(job: Any) -> str:
    """Counted only: nothing is judged by it."""
    if job.fence:
        return "a probe" if job.station.dead else "a fence"
    again = " again" if job.attempts > 1 else ""
    return f"a {job.effect.value}{again}" if job.effect.value != "none" else f"a read{again}"
