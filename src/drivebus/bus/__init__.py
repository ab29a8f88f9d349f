"""Master of one RS485 bus: ``Bus`` is its interface, ``core`` its engine without clock or I/O."""

from drivebus.bus.bus import Bus, PollSubscription
from drivebus.bus.load import BusLoad, DriveLoad, estimate_bus_load
from drivebus.bus.prepared_request import Poll
from drivebus.bus.station import Presence, StationHealth
from drivebus.bus.statistics import BusStatistics, StationStatistics
from drivebus.bus.trace import TraceEvent, TraceKind

__all__ = [
    "Bus",
    "BusLoad",
    "BusStatistics",
    "DriveLoad",
    "Poll",
    "PollSubscription",
    "Presence",
    "StationHealth",
    "StationStatistics",
    "TraceEvent",
    "TraceKind",
    "estimate_bus_load",
]
