"""A number and how far to trust it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Quality(StrEnum):
    """How far a reading can be trusted; ``reason`` of the reading says why not."""

    GOOD = "good"
    UNCERTAIN = "uncertain"
    BAD = "bad"


@dataclass(frozen=True, slots=True)
class Reading:
    """A value with its unit, quality and the monotonic second at which its request was answered.

    ``value`` is None where the drive does not report it; ``reason`` (an i18n key) then says why.
    None is never 0.0.
    """

    value: float | int | str | None
    unit: str = ""
    quality: Quality = Quality.GOOD
    source_time: float | None = None
    reason: str | None = None
    raw: int | None = None

    def age_s(self, now: float) -> float | None:
        """Seconds since the value was true on the drive, None if it never was read."""
        return None if self.source_time is None else max(0.0, now - self.source_time)


def missing_reading(reason: str, unit: str = "") -> Reading:
    """A reading that does not exist, with the reason."""
    return Reading(None, unit, Quality.BAD, None, reason)
