"""Ports, files, clocks and adapters that fail, and scenarios that run through the failures."""
