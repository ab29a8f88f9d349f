"""Limit of the wait for silence before a frame: on a bus that is never silent, a stop is sent and other frames fail."""

from __future__ import annotations

from drivebus.bus.messages import RequestPriority
from drivebus.bus.prepared_request import PreparedRequest
from drivebus.serial_settings import SerialSettings

STOP_SILENCE_TIMEOUT_CHARACTERS = 64  # a stop waits no longer for silence on a bus that is never silent
SILENCE_TIMEOUT_S = 1.0  # any other frame fails when the bus has not been silent for so long


class SilenceTimeout:
    """Limit of the wait for silence, counted from the moment at which a frame was ready and the bus was not."""

    __slots__ = ("_settings", "_started_at")

    def __init__(self, settings: SerialSettings) -> None:
        self._settings = settings
        self._started_at: float | None = None

    def reset(self) -> None:
        """Stop counting: a frame was sent, or none is waiting."""
        self._started_at = None

    def expired(self, prepared: PreparedRequest, now: float) -> bool:
        return now >= self.deadline(prepared, now)

    def deadline(self, prepared: PreparedRequest, now: float) -> float:
        """Return the time at which this frame stops waiting; the first call starts counting."""
        if self._started_at is None:
            self._started_at = now
        stop_s = prepared.gap_s + self._settings.seconds(STOP_SILENCE_TIMEOUT_CHARACTERS)
        return self._started_at + (stop_s if prepared.priority is RequestPriority.STOP else SILENCE_TIMEOUT_S)
