"""What the pure core asks of the outside world, as values. Nothing here does anything."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from drivebus.bus.trace import TraceEvent
from drivebus.protocols.codec import BusResult


@dataclass(slots=True)
class Send:
    """Write these bytes now: the first bit leaves at the ``now`` of the call that returned this."""

    data: bytes


@dataclass(slots=True)
class SetTimer:
    """Call ``woke`` at this monotonic second; replaces every earlier SetTimer. None: nothing to wait for."""

    when: float | None


@dataclass(slots=True)
class DeliverResult:
    """The ask that was submitted (or is polled) under ``token`` has its answer."""

    token: Any
    result: BusResult


@dataclass(slots=True)
class EmitTrace:
    """Something was on the wire; only made while somebody listens."""

    event: TraceEvent


CoreCommand = Send | SetTimer | DeliverResult | EmitTrace
