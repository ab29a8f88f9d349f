"""Progress of a speed toward the commanded one, however slow the ramp is, and a lasting difference from it."""

from __future__ import annotations

import math

from drivebus.drives.state import DriveStatus
from drivebus.values import Quality

SPEED_PROGRESS_HZ = 0.02  # a smaller step toward the commanded frequency is no progress
SPEED_PROGRESS_TIMEOUT_S = 5.0  # without progress for so long the speed is steady (3,600 s ramp: 0.07 Hz in 5 s)
OTHER_SPEED_SHARE = 0.1  # difference as a share of the commanded frequency; slip compensation is well below it
MIN_OTHER_SPEED_HZ = 0.5  # least difference, which counts at low frequencies
MIN_TURNING_HZ = 0.1  # from here on a turning motor is not read as 0 Hz: most drives count 0.1 Hz or less


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


class SpeedDifference:
    """Whether a drive that executes a run command keeps another speed than the commanded one."""

    def __init__(self) -> None:
        self.since: float | None = None
        """Time of the read that showed it first, in monotonic seconds; None: the speed is right or approaches."""
        self.found_hz = 0.0
        """Output frequency that was read last, at ``found_at``."""
        self.found_at = -math.inf
        self._commanded_hz: float | None = None
        self._progress: SpeedProgress | None = None

    def update(self, status: DriveStatus, commanded_hz: float | None) -> None:
        """Compare a speed that the drive reports as good with the commanded one; None: there is none.

        Where the speed is not known, or the drive executes no run command, the last result stays.
        """
        if commanded_hz != self._commanded_hz:
            self._commanded_hz, self._progress, self.since = commanded_hz, None, None
        reading = status.readings.get("output_frequency")
        if (
            commanded_hz is None
            or reading is None
            or reading.quality is not Quality.GOOD
            or not isinstance(reading.value, int | float)
            or reading.source_time is None
            or not status.state.driven
        ):
            self._progress = None
            return
        self.found_hz, self.found_at = float(reading.value), reading.source_time
        difference_hz = abs(self.found_hz - commanded_hz)
        stands = self.found_hz == 0 and commanded_hz >= MIN_TURNING_HZ
        if not stands and difference_hz <= max(MIN_OTHER_SPEED_HZ, OTHER_SPEED_SHARE * commanded_hz):
            self._progress = self.since = None
            return
        self._progress = self._progress or SpeedProgress(self.found_at)
        self._progress.update(difference_hz, self.found_at)
        if self.since is None and not self._progress.is_recent(self.found_at):
            self.since = self.found_at
