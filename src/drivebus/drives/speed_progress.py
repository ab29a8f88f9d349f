"""Progress of a speed toward the commanded one, however slow the ramp is."""

from __future__ import annotations

import math

SPEED_PROGRESS_HZ = 0.02  # a smaller step toward the commanded frequency is no progress
SPEED_PROGRESS_TIMEOUT_S = 5.0  # without progress for so long the speed is steady (3,600 s ramp: 0.07 Hz in 5 s)


class SpeedProgress:
    """Least difference from the commanded speed so far, and when it last became less."""

    def __init__(self, progress_at: float = -math.inf) -> None:
        self._nearest_hz = math.inf
        self._progress_at = progress_at

    def update(self, difference_hz: float, now: float) -> None:
        """Add a reading; the first one only sets what the others are compared with."""
        if difference_hz < self._nearest_hz - SPEED_PROGRESS_HZ:
            self._progress_at = self._progress_at if math.isinf(self._nearest_hz) else now
            self._nearest_hz = difference_hz

    def is_recent(self, now: float) -> bool:
        """Return whether the speed came nearer within the last 5 s."""
        return now - self._progress_at < SPEED_PROGRESS_TIMEOUT_S
