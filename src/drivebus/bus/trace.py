"""What was on the wire, told at three levels: that something was, its bytes, its meaning. No clock lives here."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any


class TraceKind(StrEnum):
    """What became of some bytes."""

    SENT = "sent"
    REPLY = "reply"
    """Accepted as the answer to our request."""
    INVALID = "void"
    """Came while we waited and was refused; ``error`` says why."""
    NO_REPLY = "silence"
    """Nothing (or nothing whole) came before the deadline."""
    FOREIGN = "foreign"
    """Another station's frame (F02)."""
    LATE = "late"
    """The answer to a request that had been given up (F01)."""
    DUPLICATE = "duplicate"
    """A second answer to a request that has its answer (F15)."""
    FOREIGN_REQUEST = "master"
    """A request that we did not send: somebody else is master here (F14)."""
    UNSOLICITED = "unsolicited"
    """Bytes that nobody can place."""
    BEFORE_TX_END = "early"
    """Before our own last stop bit: can be no answer (F03)."""


@dataclass(frozen=True, slots=True)
class TraceEvent:
    """Some bytes on the wire and their meaning. ``time``: monotonic second of the first bit sent or last heard."""

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
        """One line of text. Level 0: that it was; 1: its bytes too; 2: its meaning too."""
        parts = [f"{self.time:.6f}", self.kind.value, "-" if self.station is None else str(self.station)]
        if level >= 1:
            parts.append(self.data.hex(" ").upper() or "-")
        if level >= 2:
            meaning = self.error if self.error is not None else self.message
            parts.append("" if meaning is None else str(meaning))
        return "  ".join(parts).rstrip()
