"""What the pure core asks of the outside world, as values. Nothing here does anything."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from drivebus.bus.trace import TraceEvent
from drivebus.message import Answer


@dataclass(slots=True)
class Transmit:
    """Write these bytes now: the first bit leaves at the ``now`` of the call that returned this."""

    data: bytes


@dataclass(slots=True)
class WakeAt:
    """Call ``woke`` at this monotonic second; replaces every earlier WakeAt. None: nothing to wait for."""

    when: float | None


@dataclass(slots=True)
class Done:
    """The ask that was submitted (or is polled) under ``token`` has its answer."""

    token: Any
    answer: Answer


@dataclass(slots=True)
class Traced:
    """Something was on the wire; only made while somebody listens."""

    event: TraceEvent


Act = Transmit | WakeAt | Done | Traced
