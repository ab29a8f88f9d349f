"""``plant.toml``: read, judged, costed and compared. Opens no port and sends nothing."""

from drivebus.plant.config.arithmetic import costs
from drivebus.plant.config.difference import Difference, Fate, apply, difference
from drivebus.plant.config.load import load, loads
from drivebus.plant.config.polling import dialect_of, line_in, polls_of, profile_of

__all__ = [
    "Difference",
    "Fate",
    "apply",
    "costs",
    "dialect_of",
    "difference",
    "line_in",
    "load",
    "loads",
    "polls_of",
    "profile_of",
]
