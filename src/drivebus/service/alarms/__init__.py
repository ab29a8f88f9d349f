"""Alarms: what is wrong now, who has seen it, and what was wrong before. The engine is pure; the log is a file."""

from drivebus.service.alarms.engine import AlarmEngine
from drivebus.service.alarms.model import Alarm, AlarmChange, SystemAlarm

__all__ = ["Alarm", "AlarmChange", "AlarmEngine", "SystemAlarm"]
