"""Commands of the bus engine to its I/O, as values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from drivebus.bus.messages import BusResult
from drivebus.bus.trace import TraceEvent


@dataclass(slots=True)
class Send:
    """Write these bytes now: the first bit is sent at the ``now`` of the call that returned this."""

    data: bytes


@dataclass(slots=True)
class DeliverResult:
    """Deliver the result of the request that was submitted, or is polled, under ``token``."""

    token: Any
    result: BusResult


@dataclass(slots=True)
class EmitTrace:
    """Report bytes on the wire, while tracing is on."""

    event: TraceEvent


CoreCommand = Send | DeliverResult | EmitTrace
