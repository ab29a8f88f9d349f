"""Trace of the bytes on the wire, as events and as text."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any


class TraceKind(StrEnum):
    """Classification of bytes on the wire."""

    SENT = "sent"
    REPLY = "reply"
    """Accepted as the reply to our request."""
    INVALID = "invalid"
    """Received in place of a reply and rejected; ``error`` gives the reason."""
    NO_REPLY = "no_reply"
    """Nothing was received before the deadline."""
    FOREIGN = "foreign"
    """A frame of another station."""
    LATE = "late"
    """The reply to a request that had been given up."""
    DUPLICATE = "duplicate"
    """A second reply to one request."""
    FOREIGN_REQUEST = "foreign_request"
    """A request of another master."""
    UNSOLICITED = "unsolicited"
    """Not attributable."""
    BEFORE_TX_END = "before_tx_end"
    """Received before our own last stop bit: can be no reply."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TraceEvent:
    """Bytes on the wire. ``time``: monotonic second of the first bit sent or the last byte received."""

    time: float
    kind: TraceKind
    data: bytes = b""
    station: int | None = None
    message: Any = None
    """The decoded request or reply, where there is one."""
    error: Exception | None = None
    attempt: int = 0

    @property
    def direction(self) -> str:
        """``sent`` or ``received``."""
        return "sent" if self.kind is TraceKind.SENT else "received"

    def text(self, level: int = 2) -> str:
        """Return one line of text. Level 0: time, kind and station; 1: the bytes too; 2: the meaning too."""
        parts = [f"{self.time:.6f}", self.kind.value, "-" if self.station is None else str(self.station)]
        if level >= 1:
            parts.append(self.data.hex(" ").upper() or "-")
        if level >= 2:
            meaning = self.error if self.error is not None else self.message
            parts.append("" if meaning is None else str(meaning))
        return "  ".join(parts).rstrip()
