"""Incidents: values, states, events and frames of the minute before a drive tripped, saved for later analysis."""

from drivebus.service.incidents.recorder import IncidentRecorder
from drivebus.service.incidents.store import IncidentStore

__all__ = ["IncidentRecorder", "IncidentStore"]
