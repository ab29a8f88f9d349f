"""Configuration of a plant: loading, checking, comparing and load estimates of ``plant.toml``. Opens no port."""

from drivebus.service.config.bus_load import bus_loads, dialect_of, polls_of, profile_of, serial_settings_in
from drivebus.service.config.diff import ConfigDiff, ReloadAction, apply_diff, config_diff
from drivebus.service.config.load import load, loads

__all__ = [
    "ConfigDiff",
    "ReloadAction",
    "apply_diff",
    "bus_loads",
    "config_diff",
    "dialect_of",
    "load",
    "loads",
    "polls_of",
    "profile_of",
    "serial_settings_in",
]
