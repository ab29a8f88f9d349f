"""What the plant keeps of the past: samples with rollups, events, and other rooms' documents; SQLite or PostgreSQL."""

from drivebus.plant.historian.historian import FLUSH_S, Historian

__all__ = ["FLUSH_S", "Historian"]
