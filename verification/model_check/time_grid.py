"""A line on which every frame, every answer, every gap and every quarantine takes one tick, and time is a grid.

The grid has each whole tick and the instant just after it, so that "at the limit" and "past the limit" are different
instants and all order of events on it is finite. All of it is exact in binary.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import floor

from drivebus.serial_settings import SerialSettings, StationTiming

FINE_STEP_S = 2.0**-10
"""Just after."""
GRID_START_S = 4096.0
"""When the story begins: what lies before it is long ago."""


@dataclass(frozen=True, slots=True)
class TimeGrid:
    """``tick_s`` a power of two or a whole number of seconds; ``fine``: with the instants just after the ticks."""

    tick_s: float
    fine: bool = True

    def after(self, now: float) -> float:
        """The next instant."""
        whole = floor(now / self.tick_s) * self.tick_s
        return now + FINE_STEP_S if self.fine and now == whole else whole + self.tick_s

    @property
    def timing(self) -> StationTiming:
        """Every delay of a station, on this grid."""
        return StationTiming(
            gap_characters=1.0,
            reply_delay_s=0.0,
            adapter_latency_s=0.0,
            turnaround_s=self.tick_s,
            max_reply_lateness_s=self.tick_s,
        )


class GridSerialSettings(SerialSettings):
    """Any number of characters takes one tick: lengths are left out of the question."""

    tick_s = 0.5
    character_s = 0.0  # no station, no gap

    def seconds(self, characters: float) -> float:
        return self.tick_s if characters else 0.0


def grid_serial_settings(grid: TimeGrid) -> SerialSettings:
    """The line of a grid."""
    kind = type("Line", (GridSerialSettings,), {"tick_s": grid.tick_s})
    made: SerialSettings = kind()
    return made
