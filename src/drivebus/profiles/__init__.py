"""Profiles: the facts of each drive model in one TOML file, strictly checked and frozen once loaded."""

from drivebus.profiles.load import load, models, similar_models, user_directory
from drivebus.profiles.model import DriveProfile

__all__ = ["DriveProfile", "load", "models", "similar_models", "user_directory"]
