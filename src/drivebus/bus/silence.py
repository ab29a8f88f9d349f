"""How long a frame waits for a line that does not fall silent. Pure."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivebus.protocols.codec import RequestPriority

if TYPE_CHECKING:
    from drivebus.bus.prepared_request import PreparedRequest
    from drivebus.serial_settings import SerialSettings

STOP_SILENCE_TIMEOUT_CHARACTERS = 64
"""A stop waits no longer than this for a babbling line to fall silent (I3): longer than any frame of these families."""
SILENCE_TIMEOUT_S = 1.0
"""Everything else fails when the line has not been silent for this long."""


class SilenceTimeout:
    """Counts from the moment at which a frame was first ready and the line was not."""

    __slots__ = ("_settings", "_started_at")

    def __init__(self, settings: SerialSettings) -> None:
        self._settings = settings
        self._started_at: float | None = None

    def reset(self) -> None:
        """Something was sent, or nothing is to be sent."""
        self._started_at = None

    def expired(self, job: PreparedRequest, now: float) -> bool:
        """Has this frame waited long enough for silence?"""
        return now >= self.deadline(job, now)

    def deadline(self, job: PreparedRequest, now: float) -> float:
        if self._started_at is None:
            self._started_at = now
        stop_s = job.gap_s + self._settings.seconds(STOP_SILENCE_TIMEOUT_CHARACTERS)
        return self._started_at + (stop_s if job.priority is RequestPriority.STOP else SILENCE_TIMEOUT_S)
