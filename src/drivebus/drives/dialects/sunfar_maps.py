"""What the C320 manual's numbers mean for a drive: states, operations, responses, and which reads make good fences."""

from __future__ import annotations

from itertools import zip_longest
from typing import Any

from drivebus.drives.dialects.base import StopMode
from drivebus.drives.state import Direction, DriveState
from drivebus.errors import ConfigurationError
from drivebus.profiles.model import DriveProfile
from drivebus.protocols.codec import Effect
from drivebus.protocols.sunfar import SunfarControl, SunfarOperation, SunfarState, SunfarWriteParameter

_F, _R = Direction.FORWARD, Direction.REVERSE
DRIVE_STATES: dict[int, tuple[DriveState, Direction | None]] = {
    SunfarState.NOT_READY: (DriveState.NOT_READY, None),
    SunfarState.RUNNING_FORWARD: (DriveState.RUNNING, _F),
    SunfarState.RUNNING_REVERSE: (DriveState.RUNNING, _R),
    SunfarState.STOPPED: (DriveState.STOPPED, None),
    SunfarState.JOGGING_FORWARD: (DriveState.JOGGING, _F),
    SunfarState.JOGGING_REVERSE: (DriveState.JOGGING, _R),
    SunfarState.ACCELERATING_FORWARD: (DriveState.ACCELERATING, _F),
    SunfarState.ACCELERATING_REVERSE: (DriveState.ACCELERATING, _R),
    SunfarState.RESTARTING: (DriveState.RESTARTING, None),
    SunfarState.DECELERATING_FORWARD: (DriveState.DECELERATING, _F),
    SunfarState.DECELERATING_REVERSE: (DriveState.DECELERATING, _R),
    SunfarState.DC_BRAKING: (DriveState.BRAKING, None),
    SunfarState.FAULT: (DriveState.FAULT, None),
    SunfarState.EMERGENCY_STOP: (DriveState.EMERGENCY_STOPPED, None),
}
"""Manual 2.4.6."""

STOP_OPERATIONS_BY_MODE = {
    StopMode.STOP: SunfarOperation.STOP,
    StopMode.QUICK_STOP: SunfarOperation.EMERGENCY_STOP,
    StopMode.JOG_STOP: SunfarOperation.JOG_STOP,
}
STOP_OPERATIONS = frozenset(STOP_OPERATIONS_BY_MODE.values())
MOTION_OPERATIONS = frozenset(
    {
        SunfarOperation.RUN_FORWARD,
        SunfarOperation.RUN_REVERSE,
        SunfarOperation.JOG_FORWARD,
        SunfarOperation.JOG_REVERSE,
        SunfarOperation.RUN_FORWARD_AT,
        SunfarOperation.RUN_REVERSE_AT,
        SunfarOperation.JOG_FORWARD_AT,
        SunfarOperation.JOG_REVERSE_AT,
    }
)

REJECTION_KEYS = {
    1: "drives.sifang_response_1",
    2: "drives.sifang_response_2",
    3: "drives.sifang_response_3",
    4: "drives.sifang_response_4",
    6: "drives.sifang_response_6",
    7: "drives.sifang_response_7",
    8: "drives.sifang_response_8",
}
"""Manual 2.4.5; the codec lets no other code through."""


def operation_effect(request: Any, operation: SunfarOperation) -> Effect:
    if operation in MOTION_OPERATIONS:
        return Effect.MOTION
    if operation is SunfarOperation.NONE:
        return Effect.SETTING if isinstance(request, (SunfarWriteParameter, SunfarControl)) else Effect.NONE
    pure_stop = isinstance(request, SunfarControl) and operation in STOP_OPERATIONS and request.data == 0
    return Effect.STOP if pure_stop else Effect.SETTING


def sync_tags(profile: DriveProfile) -> list[tuple[int, int]]:
    """Readable parameters of groups other than 0, neighbours in different groups: a fault hides the item (ruling 2)."""
    groups: dict[int, list[tuple[int, int]]] = {}
    for parameter in profile.parameters.values():
        group, item = parameter.locator[1] >> 8, parameter.locator[1] & 0xFF
        if parameter.locator[0] == "parameter" and group and parameter.readable:
            groups.setdefault(group, []).append((group, item))
    rounds = zip_longest(*(sorted(keys) for _, keys in sorted(groups.items())))
    tags = [key for turn in rounds for key in turn if key is not None]
    if not tags:
        raise ConfigurationError("drives.no_fence", model=profile.model)
    return tags
