"""What the user means: drives of every family, driven by their profiles. ``Drive`` and ``bus_stop`` are the doors."""

from drivebus.drives.busstop import StopReport, bus_stop
from drivebus.drives.drive import Drive
from drivebus.drives.make import make_dialect
from drivebus.drives.memory import DriveLimits
from drivebus.drives.monitor import Monitor
from drivebus.drives.state import Direction, DriveState, DriveStatus, Fault, Outcome, OutcomeWord
from drivebus.drives.store import FileStore, MemoryStore

__all__ = [
    "Direction",
    "Drive",
    "DriveLimits",
    "DriveState",
    "DriveStatus",
    "Fault",
    "FileStore",
    "MemoryStore",
    "Monitor",
    "Outcome",
    "OutcomeWord",
    "StopReport",
    "bus_stop",
    "make_dialect",
]
