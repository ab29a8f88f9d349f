"""Measures every stop of a stand on the copper: what went before it, and whether it came in time (I3).

A stop must follow the frame on the wire, whatever that is: after the time that its drive may take to reply (by
``bounds``), the gap and nothing else. Where several drives are to be stopped, their stops take turns.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from verification.reference.request_effects import RequestEffect, classify_request
from verification.scenario.scenario import Scenario
from verification.timing_bounds import TimingBounds

STOP_TOLERANCE_S = 1e-3
"""G06, virtual."""
STOP_EPSILON_S = 1e-9


class SentRequest(NamedTuple):
    """A request of the host on the copper."""

    start: float
    end: float
    address: int
    effect: RequestEffect
    data: bytes


@dataclass(slots=True)
class PendingStop:
    """A stop that was wished and has not left yet."""

    address: int
    at: float
    due: float
    """By this second its first bit must be out."""
    after_broadcast: bool
    """A stop of all is on the wire, and nobody answers it: its turnaround is no part of 5.1."""
    earlier_stops: list[int] = field(default_factory=list)
    """Addresses that were stopped first: each other drive may be, once, and all of them by broadcasts."""
    foreign_traffic: bool = False
    """Somebody's late reply held it back."""


class StopTimer:
    """Watches one stand. ``told`` is called with each stop that left and with its frame."""

    def __init__(self, stand: Scenario, told: Callable[[PendingStop, SentRequest], None]) -> None:
        self.stand, self.on_stop_sent = stand, told
        self.bounds = TimingBounds(stand.kind, stand.bench.settings)
        self.last_request: SentRequest | None = None
        self.stopped_at: dict[int, float] = {}
        """When the last stop left, by address."""
        self._waiting: list[PendingStop] = []
        self._replies: deque[Any] = deque(maxlen=16)
        self._tap()

    def _tap(self) -> None:
        wire: Any = self.stand.bench.wire
        say = wire.transmit

        def on_say(talker: Any, data: bytes, *more: Any, **named: Any) -> Any:
            text = say(talker, data, *more, **named)
            if hasattr(talker, "receive"):
                address, does = classify_request(self.stand.kind.model, self.stand.kind.encoding, data)
                self._sent(SentRequest(text.start, text.end, address, does, data))
            else:
                self._replies.append(text)
            return text

        wire.transmit = on_say

    def on_stop_command(self, address: int) -> None:
        """A stop of this drive is wished now (the broadcast address: of all)."""
        now = self.stand.loop.time()
        turnaround = self.last_request is not None and self.last_request.address == self.stand.kind.broadcast
        self._waiting.append(PendingStop(address, now, self._free_at(now) + self.bounds.gap_s, turnaround))

    def _free_at(self, now: float) -> float:
        """When at the latest the frame on the wire is over."""
        if self.last_request is None:
            return now
        return max(
            now, self.last_request.end + self.bounds.reply_timeout_s(self.last_request.address, self.last_request.data)
        )

    def _sent(self, sent: SentRequest) -> None:
        before, self.last_request = self.last_request, sent
        if sent.effect is RequestEffect.STOP:
            self.stopped_at[sent.address] = sent.start
        babbled = before is not None and self._foreign_traffic(before, sent.start)
        for one in tuple(self._waiting):
            self._check_pending(one, sent, babbled)

    def _foreign_traffic(self, before: SentRequest, start: float) -> bool:
        """Was anything heard in the time that belonged to nobody any more?"""
        over = before.end + self.bounds.reply_timeout_s(before.address, before.data)
        return any(text.end > over and text.start < start for text in self._replies)

    def _check_pending(self, one: PendingStop, sent: SentRequest, babbled: bool) -> None:
        late_s = sent.start - one.due - (self.bounds.foreign_traffic_max_s if babbled else 0.0)
        if late_s > STOP_TOLERANCE_S:
            self._violation(
                f"G06 {sent.effect} to {sent.address} left {late_s * 1000:.1f} ms later than a stop may", one
            )
        if sent.effect is RequestEffect.STOP and sent.address == one.address:
            self._waiting.remove(one)
            one.foreign_traffic |= babbled
            self.on_stop_sent(one, sent)
            return
        one.due = sent.end + self.bounds.reply_timeout_s(sent.address, sent.data) + self.bounds.gap_s
        if sent.start <= one.at + STOP_EPSILON_S:
            one.after_broadcast |= sent.address == self.stand.kind.broadcast
            return
        if sent.effect is not RequestEffect.STOP:
            self._violation(f"I3 {sent.effect} to {sent.address} went before it", one)
        one.foreign_traffic |= babbled
        if sent.address in one.earlier_stops and sent.address != self.stand.kind.broadcast:
            self._violation(f"I3 stops of {sent.address} went before it again and again", one)
        one.earlier_stops.append(sent.address)

    def phase(self) -> str:
        """What is going on on the copper now, for the count of what was tried."""
        now, last = self.stand.loop.time(), self.last_request
        flight = self.stand.bus.core.transaction
        what = (
            "nothing"
            if flight is None
            else "a broadcast"
            if flight.prepared.is_broadcast
            else _job_name(flight.prepared)
        )
        if last is None or flight is None:
            return "idle or in a gap"
        if now < last.end:
            return f"sending {what}"
        received = any(text.start <= now < text.end for text in self._replies)
        return f"hearing the reply to {what}" if received else f"waiting after {what}"

    def finish(self) -> None:
        """Nothing may wait any more."""
        for one in self._waiting:
            self._violation("G05 it was never sent", one)

    def _violation(self, text: str, one: PendingStop) -> None:
        self.stand.oracle.violation(f"{text}: stop of {one.address}, wished at {one.at:.6f}")


def _job_name(job: Any) -> str:
    """Counted only: nothing is judged by it."""
    if job.is_sync_probe:
        return "a probe" if job.station.state.is_unreachable else "a fence"
    again = " again" if job.attempts > 1 else ""
    return f"a {job.effect.value}{again}" if job.effect.value != "none" else f"a read{again}"
