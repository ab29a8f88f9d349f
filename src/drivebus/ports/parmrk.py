"""Parity and framing marks of a POSIX terminal (INPCK | PARMRK), decoded. Pure.

With PARMRK the kernel writes ``FF 00 xx`` for a byte xx that came with a parity or framing error, ``FF 00 00`` for a
break, and ``FF FF`` for a good byte FF (termios(3), IEEE 1003.1 §11.2.2). Chunks may break a mark anywhere (G20).
"""

from __future__ import annotations

_ESCAPE = 0xFF


class ParityMarkDecoder:
    """Keeps the unfinished escape between chunks."""

    __slots__ = ("_pending",)

    def __init__(self) -> None:
        self._pending = b""

    def reset(self) -> None:
        """Forget an unfinished escape (the port was reopened)."""
        self._pending = b""

    def decode(self, chunk: bytes) -> tuple[bytes, int]:
        """The bytes of the line, and how many of them were marked as bad. Marked bytes stay in the data."""
        if not self._pending and _ESCAPE not in chunk:
            return chunk, 0
        data, self._pending = self._pending + chunk, b""
        out, marks, at = bytearray(), 0, 0
        while at < len(data):
            step = _sequence_size(data, at)
            if step == 0:
                self._pending = data[at:]
                break
            out.append(data[at + step - 1])
            marks += step == 3 or (step == 1 and data[at] == _ESCAPE)
            at += step
        return bytes(out), marks


def _sequence_size(data: bytes, at: int) -> int:
    """Bytes of the escape at ``at``: 1 plain, 2 for FF FF, 3 for FF 00 xx, 0 where its end has not come yet.

    FF followed by anything else is no sequence that a kernel writes: it counts as one bad byte, never as a good one.
    """
    if data[at] != _ESCAPE:
        return 1
    if at + 1 == len(data):
        return 0
    if data[at + 1] == _ESCAPE:
        return 2
    if data[at + 1] != 0:
        return 1
    return 3 if at + 2 < len(data) else 0
