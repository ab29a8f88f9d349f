"""Status word of a register-based drive: state and direction that it reports."""

from __future__ import annotations

from drivebus.drives.state import Direction, DriveState
from drivebus.profiles.model import StatusMap


def state_from_bits(status: StatusMap, raw: int) -> DriveState:
    """Return the state of a status word, motion first: a drive that still turns in a fault is turning."""
    for name, state in STATE_BITS:
        if raw & status.bits.get(name, 0):
            return state
    ready = status.bits.get("ready", 0)
    return DriveState.STOPPED if not ready or raw & ready else DriveState.NOT_READY


STATE_BITS = (
    ("emergency_stopping", DriveState.BRAKING),
    ("dc_braking", DriveState.BRAKING),
    ("jogging", DriveState.JOGGING),
    ("speed_search", DriveState.RESTARTING),
    ("paused", DriveState.PAUSED),
    ("running", DriveState.RUNNING),
    ("fault", DriveState.FAULT),
    ("under_voltage", DriveState.NOT_READY),
)
"""In order of precedence."""


def direction_from_bits(status: StatusMap, raw: int) -> Direction | None:
    bit = status.bits.get("output_reverse") or status.bits.get("set_reverse")
    if not bit:
        return None
    return Direction.REVERSE if raw & bit else Direction.FORWARD
