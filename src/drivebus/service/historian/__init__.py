"""What the plant keeps of the past: samples with rollups, events, and other rooms' documents; SQLite or PostgreSQL."""

from drivebus.service.historian.historian import FLUSH_INTERVAL_S, Historian

__all__ = ["FLUSH_INTERVAL_S", "Historian"]
