"""Comparison of an attached drive with what was commanded: direction and speed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from drivebus.values import Quality

if TYPE_CHECKING:
    from drivebus.drives.state import Direction, DriveStatus

SPEED_REMARK_TOLERANCE = 0.1  # share of the commanded frequency; slip compensation is well below it
MIN_SPEED_REMARK_HZ = 0.5  # and never less than this
SPEED_PROGRESS_HZ = 0.02  # a smaller step toward the commanded frequency is no progress (3,600 s ramp: 0.07 Hz in 5 s)
SPEED_PROGRESS_TIMEOUT_S = 5.0  # without progress for so long the speed is remarked on


@dataclass(frozen=True, slots=True)
class Remark:
    """A sentence of the catalogue about the drive: key and parameters."""

    key: str
    params: dict[str, Any]


class RunWatch:
    """Watch of a running drive; each difference is remarked on once, and again only after it was gone."""

    def __init__(self, frequency_hz: float, direction: Direction) -> None:
        self._frequency_hz, self._direction = frequency_hz, direction
        self._direction_remarked = self._speed_remarked = False
        self._nearest_hz: float | None = None  # least difference of the speed so far
        self._progress_at = 0.0

    def update(self, status: DriveStatus, now: float) -> list[Remark]:
        """Return what is new to remark on. ``now``: monotonic seconds."""
        return [remark for remark in (self._check_direction(status), self._check_speed(status, now)) if remark]

    def _check_direction(self, status: DriveStatus) -> Remark | None:
        differs = status.direction is not None and status.direction is not self._direction
        before, self._direction_remarked = self._direction_remarked, differs
        if before or not differs:
            return None
        return Remark("run.wrong_direction", {"expected": self._direction, "found": status.direction})

    def _check_speed(self, status: DriveStatus, now: float) -> Remark | None:
        """Compare a speed that the drive reports as good; while it approaches the commanded one all is well."""
        reading = status.readings.get("output_frequency")
        usable = reading is not None and reading.quality is Quality.GOOD and isinstance(reading.value, int | float)
        if not usable or reading is None or not status.state.driven:
            self._nearest_hz = None
            return None
        difference_hz = abs(float(reading.value or 0.0) - self._frequency_hz)
        if difference_hz <= max(MIN_SPEED_REMARK_HZ, SPEED_REMARK_TOLERANCE * self._frequency_hz):
            self._nearest_hz, self._speed_remarked = None, False
            return None
        if self._nearest_hz is None or difference_hz < self._nearest_hz - SPEED_PROGRESS_HZ:
            self._nearest_hz, self._progress_at = difference_hz, now
        if self._speed_remarked or now - self._progress_at < SPEED_PROGRESS_TIMEOUT_S:
            return None
        self._speed_remarked = True
        key = "run.other_speed" if reading.value else "run.zero_speed"
        return Remark(key, {"expected_hz": self._frequency_hz, "found_hz": reading.value})
