"""Status word of a register-based drive: state and direction that it reports."""

from __future__ import annotations

from drivebus.drives.state import Direction, DriveState
from drivebus.profiles.model import StatusMap

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
"""In order of precedence: motion first, because a drive that still turns in a fault is turning."""
DIRECTION_SUFFIXES = {"_forward": Direction.FORWARD, "_reverse": Direction.REVERSE}
"""Endings of the names of values that tell a direction: running_forward."""


def is_valid_status(status: StatusMap, raw: int) -> bool:
    """Return whether no reserved bit is set, or the value is one that the profile lists."""
    if status.values:
        return raw & status.mask in status.values
    return not raw & status.reserved_mask


def status_state(status: StatusMap, raw: int) -> DriveState:
    """Return the state of a valid status word."""
    if status.values:
        return _split_value(status, raw)[0]
    for name, state in STATE_BITS:
        if raw & status.bits.get(name, 0):
            return state
    ready = status.bits.get("ready", 0)
    return DriveState.STOPPED if not ready or raw & ready else DriveState.NOT_READY


def status_direction(status: StatusMap, raw: int) -> Direction | None:
    """Return the direction of a valid status word, None where it tells none."""
    if status.values:
        return _split_value(status, raw)[1]
    bit = status.bits.get("output_reverse") or status.bits.get("set_reverse")
    if not bit:
        return None
    return Direction.REVERSE if raw & bit else Direction.FORWARD


def _split_value(status: StatusMap, raw: int) -> tuple[DriveState, Direction | None]:
    name = status.values[raw & status.mask]
    for suffix, direction in DIRECTION_SUFFIXES.items():
        if name.endswith(suffix):
            return DriveState(name.removesuffix(suffix)), direction
    return DriveState(name), None
