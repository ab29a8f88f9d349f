"""``ExchangeLog``: frames of an operation with their replies, the evidence of its outcome."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

from drivebus.bus.messages import BusResult
from drivebus.drives.outcome import FrameExchange
from drivebus.errors import DrivebusError
from drivebus.protocols.codec import Effect

MAX_COMMAND_EXCHANGES = 64  # most frames of commands and stops that an outcome holds
MAX_READ_EXCHANGES = 24  # most reads that an outcome holds, the last ones: a repeated stop reads without end


class ExchangeLog:
    """Frames of one operation with their replies, at most 64 commands and the last 24 reads."""

    def __init__(self) -> None:
        self._commands: deque[FrameExchange] = deque(maxlen=MAX_COMMAND_EXCHANGES)
        self._reads: deque[FrameExchange] = deque(maxlen=MAX_READ_EXCHANGES)

    def add(self, result: BusResult, effect: Effect) -> None:
        """Add a frame that was sent."""
        log = self._reads if effect is Effect.NONE else self._commands
        log.append(frame_exchange(result))

    def in_order(self) -> tuple[FrameExchange, ...]:
        """Return the frames in the order in which they were sent."""
        both = [*self._commands, *self._reads]
        return tuple(sorted(both, key=lambda e: e.sent_at if e.sent_at is not None else 0.0))


def frame_exchange(result: BusResult) -> FrameExchange:
    """Return the frame and the reply of a transaction."""
    exchange = FrameExchange(
        sent=result.sent, received=result.received, sent_at=result.sent_at, received_at=result.received_at
    )
    error = result.error
    return replace(exchange, error=error.key, params=error.params) if isinstance(error, DrivebusError) else exchange
