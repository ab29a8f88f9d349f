"""Alarms of a plant (ISA-18.2): conditions, engine and log."""

from drivebus.service.alarms.engine import AlarmEngine
from drivebus.service.alarms.model import Alarm, AlarmChange, SystemAlarm

__all__ = ["Alarm", "AlarmChange", "AlarmEngine", "SystemAlarm"]
