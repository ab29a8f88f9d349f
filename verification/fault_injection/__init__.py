"""Ports, files, clocks and adapters that fail, and what must hold while they do."""
