"""Alarms: what is wrong now, who has seen it, and what was wrong before. The engine is pure; the log is a file."""

from drivebus.plant.alarms.alarm import Alarm, Change, Own
from drivebus.plant.alarms.book import AlarmBook

__all__ = ["Alarm", "AlarmBook", "Change", "Own"]
