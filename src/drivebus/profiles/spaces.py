"""Address spaces of Modbus, as locators name them."""

from __future__ import annotations

READ_FUNCTION_BY_SPACE = {"coil": 1, "discrete": 2, "holding": 3, "input": 4}
BIT_SPACES = ("coil", "discrete")
"""Spaces of single bits; the others have registers of 16."""
SYNC_READ_COUNT = 2
"""Registers of a sync probe without FC08, by which its reply is recognized: no other read of its space has it."""
