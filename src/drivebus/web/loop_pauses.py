"""``LoopPauses``: how long the event loop of this process stood still a moment ago."""

from __future__ import annotations

import asyncio
from math import inf

BEAT_INTERVAL_S = 0.25
UNREAD_AFTER_PAUSE_S = 1.0  # after a pause, requests that waited in the system are read within it


class LoopPauses:
    """Pauses of the event loop: a request that is read soon after one may have waited as long.

    The system keeps what clients send to a process that is suspended, also of clients that have given up by then.
    """

    def __init__(self) -> None:
        self._turned_at: float | None = None
        """Time of the last beat; None where ``run`` is not under way."""
        self._last_pause_s, self._last_pause_ended_at = 0.0, -inf

    async def run(self) -> None:
        """Measure until cancelled."""
        clock = asyncio.get_running_loop().time
        try:
            while True:
                self._turned_at = clock()
                await asyncio.sleep(BEAT_INTERVAL_S)
                now = clock()
                if (pause_s := self._present_pause_s(now)) >= self._ended_pause_s(now):
                    self._last_pause_s, self._last_pause_ended_at = pause_s, now
        finally:
            self._turned_at = None

    def recent_pause_s(self) -> float:
        """Return the longest time that a request which is read now may have waited for the loop."""
        now = asyncio.get_running_loop().time()
        return max(self._present_pause_s(now), self._ended_pause_s(now))

    def _present_pause_s(self, now: float) -> float:
        return 0.0 if self._turned_at is None else max(0.0, now - self._turned_at - BEAT_INTERVAL_S)

    def _ended_pause_s(self, now: float) -> float:
        return self._last_pause_s if now - self._last_pause_ended_at < UNREAD_AFTER_PAUSE_S else 0.0
