"""How long a frame waits for a line that does not fall silent. Pure."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivebus.message import Lane

if TYPE_CHECKING:
    from drivebus.bus.job import Job
    from drivebus.line import LineSettings

STOP_PATIENCE_CHARACTERS = 64
"""A stop waits no longer than this for a babbling line to fall silent (I3): longer than any frame of these families."""
BABBLE_S = 1.0
"""Everything else fails when the line has not been silent for this long."""


class Patience:
    """Counts from the moment at which a frame was first ready and the line was not."""

    __slots__ = ("_line", "_since")

    def __init__(self, line: LineSettings) -> None:
        self._line = line
        self._since: float | None = None

    def renew(self) -> None:
        """Something was sent, or nothing is to be sent."""
        self._since = None

    def over(self, job: Job, now: float) -> bool:
        """Has this frame waited long enough for silence?"""
        return now >= self.until(job, now)

    def until(self, job: Job, now: float) -> float:
        if self._since is None:
            self._since = now
        stop_s = job.gap_s + self._line.seconds(STOP_PATIENCE_CHARACTERS)
        return self._since + (stop_s if job.lane is Lane.STOP else BABBLE_S)
