"""Simulated Modbus drives written from manuals and running programs alone: independent evidence for the profiles."""
