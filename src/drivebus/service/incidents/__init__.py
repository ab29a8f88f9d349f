"""Cases: what was known of a drive in the minute before it tripped, frozen so that it can be opened later."""

from drivebus.service.incidents.recorder import IncidentRecorder
from drivebus.service.incidents.store import IncidentStore

__all__ = ["IncidentRecorder", "IncidentStore"]
