"""Drives of every protocol family, driven by their profiles: ``Drive``, ``Monitor`` and ``stop_bus``."""

from drivebus.drives.bus_stop import StopReport, stop_all_addresses, stop_bus
from drivebus.drives.context import DriveLimits
from drivebus.drives.dialects.create import create_dialect
from drivebus.drives.drive import Drive
from drivebus.drives.monitor import Monitor
from drivebus.drives.outcome import Outcome, OutcomeStatus
from drivebus.drives.state import Direction, DriveState, DriveStatus, Fault
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
    "OutcomeStatus",
    "StopReport",
    "create_dialect",
    "stop_all_addresses",
    "stop_bus",
]
