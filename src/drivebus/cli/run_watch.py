"""Watch of an attached drive: whether its state is known, and its direction and speed beside the commanded ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from drivebus.drives.speed_progress import SpeedDifference
from drivebus.drives.state import DriveState
from drivebus.errors import DrivebusError, PortLost
from drivebus.values import Text, bilingual_text

if TYPE_CHECKING:
    from drivebus.drives.state import Direction, DriveStatus

OUTAGE_REPEAT_S = 10.0  # interval of the remark that the state is not known


@dataclass(frozen=True, slots=True)
class Remark:
    """A sentence of the catalogue about the drive: key and parameters."""

    key: str
    params: dict[str, Any]


class Outage:
    """Time in which the state of the drive is not known: remarked on at first, for each new reason and every 10 s."""

    def __init__(self, known_at: float) -> None:
        self._known_at = known_at  # time of the last known state; at first of the start's outcome
        self._remarked_at: float | None = None  # None while the state is known
        self._reasons: set[str] = set()

    def end(self, now: float) -> Remark | None:
        """Note a known state; return the remark that ends an outage."""
        remark = None if self._remarked_at is None else Remark("run.known_again", {"seconds": self._duration_s(now)})
        self._known_at, self._remarked_at = now, None
        self._reasons.clear()
        return remark

    def add(self, key: str, reason: str, text: Text, now: float) -> Remark | None:
        """Note a status that failed for a reason; return the remark that is due."""
        is_known = reason in self._reasons
        self._reasons.add(reason)
        if is_known and self._remarked_at is not None and now - self._remarked_at < OUTAGE_REPEAT_S:
            return None
        self._remarked_at = now
        return Remark(key, {"why": text, "seconds": self._duration_s(now)})

    def _duration_s(self, now: float) -> float:
        return round(now - self._known_at, 1)


class RunWatch:
    """Watch of a running drive; each difference is remarked on once, and again only after it was gone."""

    def __init__(self, frequency_hz: float, direction: Direction, started_at: float) -> None:
        self._frequency_hz, self._direction = frequency_hz, direction
        self._direction_remarked = False
        self._speed = SpeedDifference()
        self._outage = Outage(started_at)

    def update(self, status: DriveStatus, now: float) -> list[Remark]:
        """Return what is new to remark on. ``now``: monotonic seconds."""
        remarks = self._check_known(status, now), self._check_direction(status), self._check_speed(status)
        return [remark for remark in remarks if remark]

    def on_failure(self, error: DrivebusError, now: float) -> Remark | None:
        """Return what is to remark on after a status that failed."""
        key = "run.port_lost" if isinstance(error, PortLost) else "run.no_reply"
        return self._outage.add(key, error.key, Text.per_language(error.text), now)

    def _check_known(self, status: DriveStatus, now: float) -> Remark | None:
        """Compare with a known state; a drive that can't report one (DF800) is never without it."""
        if status.state is not DriveState.UNKNOWN or status.reason == "drives.no_run_status":
            return self._outage.end(now)
        reason = status.reason or "drives.not_read"
        return self._outage.add("run.no_reply", reason, bilingual_text(reason), now)

    def _check_direction(self, status: DriveStatus) -> Remark | None:
        differs = status.direction is not None and status.direction is not self._direction
        before, self._direction_remarked = self._direction_remarked, differs
        if before or not differs:
            return None
        return Remark("run.wrong_direction", {"expected": self._direction, "found": status.direction})

    def _check_speed(self, status: DriveStatus) -> Remark | None:
        before = self._speed.since
        self._speed.update(status, self._frequency_hz)
        if before is not None or self._speed.since is None:
            return None
        found_hz = self._speed.found_hz
        key = "run.other_speed" if found_hz else "run.zero_speed"
        return Remark(key, {"expected_hz": self._frequency_hz, "found_hz": found_hz})
