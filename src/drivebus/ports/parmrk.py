"""Decoder of the parity and framing marks of a POSIX terminal (INPCK | PARMRK).

With PARMRK the kernel writes ``FF 00 xx`` for a byte xx with a parity or framing error, ``FF 00 00`` for a break, and
``FF FF`` for a good byte FF (termios(3), IEEE 1003.1 section 11.2.2). A chunk may end anywhere within a mark.
"""

from __future__ import annotations

_ESCAPE = 0xFF


class ParityMarkDecoder:
    """Decoder that keeps the unfinished escape sequence between chunks."""

    __slots__ = ("_pending",)

    def __init__(self) -> None:
        self._pending = b""

    def reset(self) -> None:
        """Forget an unfinished sequence (the port was reopened)."""
        self._pending = b""

    def decode(self, chunk: bytes) -> tuple[bytes, int]:
        """Return the bytes and how many of them had a line error. Those bytes stay in the data."""
        if not self._pending and _ESCAPE not in chunk:
            return chunk, 0
        data, self._pending = self._pending + chunk, b""
        out, line_errors, at = bytearray(), 0, 0
        while at < len(data):
            step = _sequence_size(data, at)
            if step == 0:
                self._pending = data[at:]
                break
            out.append(data[at + step - 1])
            line_errors += step == 3 or (step == 1 and data[at] == _ESCAPE)
            at += step
        return bytes(out), line_errors


def _sequence_size(data: bytes, at: int) -> int:
    """Return the size of the sequence at ``at``: 1 plain, 2 for FF FF, 3 for FF 00 xx, 0 where it is not whole yet.

    FF followed by anything else is written by no kernel: it counts as one bad byte, never as a good one.
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
