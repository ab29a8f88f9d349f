"""What is known of each drive model, as data: one TOML file a model, checked strictly, frozen once loaded."""

from drivebus.profiles.load import load, models, user_directory
from drivebus.profiles.model import DriveProfile

__all__ = ["DriveProfile", "load", "models", "user_directory"]
