"""Cases: what was known of a drive in the minute before it tripped, frozen so that it can be opened later."""

from drivebus.plant.cases.recorder import FlightRecorder
from drivebus.plant.cases.store import CaseStore

__all__ = ["CaseStore", "FlightRecorder"]
