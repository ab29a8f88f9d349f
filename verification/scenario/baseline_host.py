"""The control: a bare host that flushes, asks, and takes the first frame with the right length, address and function.

So do many programs (RELIABILITY F01). It runs on the line of a campaign in place of the bus and must be seen to fail
there; a campaign on which even this host makes no mistake would prove nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from verification.drive_variants import DriveVariant

BASELINE_TIMEOUT_S = 0.1
BASELINE_GAP_CHARACTERS = 6

BASELINE_REPLY_SHAPES = {
    "c320-ascii": (18, (0, 1, 2)),
    "c320-hex": (18, (0, 1, 2)),
    "dzb100": (11, (0, 3, 4)),
    "vc660": (7, (0, 1)),
    "df800-rtu": (7, (0, 1)),
    "df800-ascii": (15, (1, 2, 3, 4)),
}
"""Bytes of the answer to a read of one value, and the places where it repeats the request's address and function."""


def is_plausible_reply(kind: DriveVariant, asked: bytes, heard: bytes) -> bool:
    """Would this host take those bytes for the answer?"""
    size, places = BASELINE_REPLY_SHAPES[kind.name]
    return len(heard) == size and all(heard[place] == asked[place] for place in places)


class BaselineHost:
    """Asks in turns for ever. ``believed(address, sent_at, now, data)`` is told of each reply that it takes."""

    def __init__(
        self,
        kind: DriveVariant,
        port: Any,
        loop: Any,
        questions: Sequence[tuple[int, bytes]],
        believed: Callable[[int, float, float, bytes], None],
    ) -> None:
        self.frames = 0
        self._kind, self._port, self._loop, self._questions, self._on_accepted = kind, port, loop, questions, believed
        self._buffer = bytearray()
        self._waiting: Any = None
        self._sent_at = 0.0

    async def open(self) -> None:
        await self._port.open(self)
        self._ask()

    def _ask(self) -> None:
        self._address, self._requests_sent = self._questions[self.frames % len(self._questions)]
        self.frames += 1
        self._buffer.clear()
        self._sent_at = self._loop.time()
        self._waiting = self._loop.call_later(BASELINE_TIMEOUT_S + self._seconds(len(self._requests_sent)), self._end)
        self._port.write(self._requests_sent)

    def _seconds(self, characters: int) -> float:
        return float(self._port.simulated_bus.settings.seconds(characters))

    def data_received(self, data: bytes, marks: int = 0) -> None:
        """From the port."""
        self._buffer += data
        if (
            self._waiting is not None
            and not marks
            and is_plausible_reply(self._kind, self._requests_sent, bytes(self._buffer))
        ):
            self._on_accepted(self._address, self._sent_at, self._loop.time(), bytes(self._buffer))
            self._waiting.cancel()
            self._end()

    def port_lost(self, error: Exception) -> None:
        """Never: nobody pulls this one."""

    def _end(self) -> None:
        self._waiting = None
        self._loop.call_later(self._seconds(BASELINE_GAP_CHARACTERS), self._ask)
