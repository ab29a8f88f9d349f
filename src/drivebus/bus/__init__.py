"""Who speaks when on one line: ``Bus`` is the master; everything that it decides is decided in the pure ``core``."""

from drivebus.bus.master import Bus
from drivebus.bus.planner import BusArithmetic, DriveArithmetic, Poll, arithmetic
from drivebus.bus.shell import Watch
from drivebus.bus.stations import Health, Presence
from drivebus.bus.statistics import BusStatistics, StationStatistics
from drivebus.bus.trace import Kind, TraceEvent

__all__ = [
    "Bus",
    "BusArithmetic",
    "BusStatistics",
    "DriveArithmetic",
    "Health",
    "Kind",
    "Poll",
    "Presence",
    "StationStatistics",
    "TraceEvent",
    "Watch",
    "arithmetic",
]
