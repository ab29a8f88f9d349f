"""``LoopPauses``: how long the event loop of this process did not run a moment ago."""

from __future__ import annotations

import asyncio

MEASURING_INTERVAL_S = 0.25
MIN_BACKLOG_S, MAX_BACKLOG_S = 1.0, 30.0
"""Requests that waited during a pause are read within a time as long as it, and within these times."""


class LoopPauses:
    """Pauses of the event loop: a request that is read soon after one may have waited as long.

    The system keeps what clients send to a process that is suspended, also of clients that have given up by then.
    Time for which the machine itself sleeps (suspend to RAM) is not counted by the clock of the loop.
    """

    def __init__(self) -> None:
        self._last_iteration_at: float | None = None
        """Time at which ``run`` last measured; None where it is not under way."""
        self._ended_pauses: list[tuple[float, float]] = []
        """Lengths of pauses, each with the time until which requests are read that waited during it."""

    async def run(self) -> None:
        """Measure until cancelled."""
        clock = asyncio.get_running_loop().time
        try:
            while True:
                self._last_iteration_at = clock()
                await asyncio.sleep(MEASURING_INTERVAL_S)
                now = clock()
                pause_s = self._present_pause_s(now)
                backlog_s = min(max(MIN_BACKLOG_S, pause_s), MAX_BACKLOG_S)
                self._ended_pauses = [pause for pause in self._ended_pauses if pause[1] > now]
                self._ended_pauses.append((pause_s, now + backlog_s))
        finally:
            self._last_iteration_at = None

    def recent_pause_s(self) -> float:
        """Return the longest pause of the loop during which a request that is read now may have waited."""
        now = asyncio.get_running_loop().time()
        ended = (pause_s for pause_s, until in self._ended_pauses if now < until)
        return max([self._present_pause_s(now), *ended])

    def _present_pause_s(self, now: float) -> float:
        if self._last_iteration_at is None:
            return 0.0
        return max(0.0, now - self._last_iteration_at - MEASURING_INTERVAL_S)
