"""Historian: samples with rollups, events and documents, in SQLite or PostgreSQL."""

from drivebus.service.historian.historian import FLUSH_INTERVAL_S, Historian

__all__ = ["FLUSH_INTERVAL_S", "Historian"]
