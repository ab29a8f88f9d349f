"""Timing of every stop on the wire: the frames before it, and its delay (I3).

A stop must follow the frame on the wire after the reply time of that frame (``TimingBounds``) and the gap. The stops of
several drives take turns.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from verification.drive_variants import TimingBounds
from verification.reference.effects import RequestEffect
from verification.scenario.scenario import Scenario, SentRequest

STOP_TOLERANCE_S = 1e-3
"""Tolerance of a stop's delay, in seconds of virtual time."""
STOP_EPSILON_S = 1e-9


@dataclass(slots=True, kw_only=True)
class PendingStop:
    """Stop that was commanded and not yet sent."""

    address: int
    at: float
    due: float
    """Latest time of its first bit."""
    after_broadcast: bool
    """A broadcast stop is on the wire, whose turnaround the stop bound does not contain."""
    earlier_stops: list[int] = field(default_factory=list)
    """Addresses that were stopped first: every other drive once, and all drives by broadcasts."""
    foreign_traffic: bool = False
    """A late reply delayed the stop."""


class StopTimer:
    """Timer of the stops of one scenario; ``on_stop_sent`` is called with each stop that was sent and its frame."""

    def __init__(self, scenario: Scenario, on_stop_sent: Callable[[PendingStop, SentRequest], None]) -> None:
        self.scenario, self.on_stop_sent = scenario, on_stop_sent
        self.bounds = TimingBounds(scenario.variant, scenario.simulated_bus.settings)
        self.last_request: SentRequest | None = None
        self.stopped_at: dict[int, float] = {}
        """Time of the last stop, by address."""
        self._waiting: list[PendingStop] = []
        self._replies: deque[Any] = deque(maxlen=16)
        scenario.observe_wire(self._on_transmission)

    def on_stop_command(self, address: int) -> None:
        """Record a stop command for a drive, or for all drives at the broadcast address."""
        now = self.scenario.loop.time()
        turnaround = self.last_request is not None and self.last_request.address == self.scenario.variant.broadcast
        self._waiting.append(
            PendingStop(address=address, at=now, due=self._free_at(now) + self.bounds.gap_s, after_broadcast=turnaround)
        )

    def _free_at(self, now: float) -> float:
        """Return the latest end of the current transaction."""
        if self.last_request is None:
            return now
        return max(
            now, self.last_request.end + self.bounds.reply_timeout_s(self.last_request.address, self.last_request.data)
        )

    def _on_transmission(self, transmission: Any, sent: SentRequest | None) -> None:
        if sent is None:
            self._replies.append(transmission)
            return
        before, self.last_request = self.last_request, sent
        if sent.effect is RequestEffect.STOP:
            self.stopped_at[sent.address] = sent.start
        foreign_traffic = before is not None and self._foreign_traffic(before, sent.start)
        for pending in tuple(self._waiting):
            self._check_pending(pending, sent, foreign_traffic=foreign_traffic)

    def _foreign_traffic(self, before: SentRequest, start: float) -> bool:
        """Return whether a reply was on the wire after the end of the last transaction."""
        over = before.end + self.bounds.reply_timeout_s(before.address, before.data)
        return any(transmission.end > over and transmission.start < start for transmission in self._replies)

    def _check_pending(self, pending: PendingStop, sent: SentRequest, *, foreign_traffic: bool) -> None:
        late_s = sent.start - pending.due - (self.bounds.foreign_traffic_max_s if foreign_traffic else 0.0)
        if late_s > STOP_TOLERANCE_S:
            self._violation(
                f"{sent.effect} to {sent.address} was sent {late_s * 1000:.1f} ms later than a stop may be", pending
            )
        if sent.effect is RequestEffect.STOP and sent.address == pending.address:
            self._waiting.remove(pending)
            pending.foreign_traffic |= foreign_traffic
            self.on_stop_sent(pending, sent)
            return
        pending.due = sent.end + self.bounds.reply_timeout_s(sent.address, sent.data) + self.bounds.gap_s
        if sent.start <= pending.at + STOP_EPSILON_S:
            pending.after_broadcast |= sent.address == self.scenario.variant.broadcast
            return
        if sent.effect is not RequestEffect.STOP:
            self._violation(f"I3 {sent.effect} to {sent.address} was sent before it", pending)
        pending.foreign_traffic |= foreign_traffic
        if sent.address in pending.earlier_stops and sent.address != self.scenario.variant.broadcast:
            self._violation(f"I3 stops of {sent.address} were sent before it repeatedly", pending)
        pending.earlier_stops.append(sent.address)

    def phase(self) -> str:
        """Return what is on the wire now, for the counts."""
        now, last = self.scenario.loop.time(), self.last_request
        transaction = self.scenario.bus.core.transaction
        what = (
            "nothing"
            if transaction is None
            else "a broadcast"
            if transaction.prepared.is_broadcast
            else _job_name(transaction.prepared)
        )
        if last is None or transaction is None:
            return "idle or in a gap"
        if now < last.end:
            return f"sending {what}"
        received = any(transmission.start <= now < transmission.end for transmission in self._replies)
        return f"receiving the reply to {what}" if received else f"waiting after {what}"

    def finish(self) -> None:
        """Report every stop that was never sent."""
        for pending in self._waiting:
            self._violation("never sent", pending)

    def _violation(self, text: str, pending: PendingStop) -> None:
        self.scenario.oracle.violation(f"{text}: stop of {pending.address}, commanded at {pending.at:.6f}")


def _job_name(job: Any) -> str:
    """Return the name of a request for the counts."""
    if job.is_sync_probe:
        return "a probe" if job.station.state.is_unreachable else "a sync probe"
    again = " again" if job.attempts > 1 else ""
    return f"a {job.effect.value}{again}" if job.effect.value != "none" else f"a read{again}"
