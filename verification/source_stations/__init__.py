"""Simulated Modbus drives written from manuals and running programs alone: independent witnesses of the profiles."""
