"""Effect and content of a request, as the manuals define them."""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple


class RequestEffect(StrEnum):
    """Effect on a drive that executes the request."""

    READ = "read"
    SETTING = "set"
    """Writes a setpoint or a parameter, or resets a fault; starts nothing."""
    MOTION = "move"
    """Starts or jogs the motor, or turns it round."""
    STOP = "stop"
    """Can only take motion away."""
    RELEASE = "rest"
    """VC660: the level bits without any pulse, written after each pulse."""


class ReferenceWrite(NamedTuple):
    """Content of a write: a frequency in Hz, or a parameter by its address, saved in the EEPROM or not."""

    hz: float | None = None
    parameter: int | None = None
    saved: bool = False
