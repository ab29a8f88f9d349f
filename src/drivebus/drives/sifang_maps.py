"""What the C320 manual's numbers mean for a drive: states, operations, responses, and which reads make good fences."""

from __future__ import annotations

from itertools import zip_longest
from typing import Any

from drivebus.drives.dialect import Stop
from drivebus.drives.state import Direction, DriveState
from drivebus.errors import ConfigurationError
from drivebus.message import Effect
from drivebus.profiles.model import DriveProfile
from drivebus.protocols.sifang import Control, Operation, State, WriteParameter

_F, _R = Direction.FORWARD, Direction.REVERSE
STATES: dict[int, tuple[DriveState, Direction | None]] = {
    State.NOT_READY: (DriveState.NOT_READY, None),
    State.RUNNING_FORWARD: (DriveState.RUNNING, _F),
    State.RUNNING_REVERSE: (DriveState.RUNNING, _R),
    State.STOPPED: (DriveState.STOPPED, None),
    State.JOGGING_FORWARD: (DriveState.JOGGING, _F),
    State.JOGGING_REVERSE: (DriveState.JOGGING, _R),
    State.ACCELERATING_FORWARD: (DriveState.ACCELERATING, _F),
    State.ACCELERATING_REVERSE: (DriveState.ACCELERATING, _R),
    State.RESTARTING: (DriveState.RESTARTING, None),
    State.DECELERATING_FORWARD: (DriveState.DECELERATING, _F),
    State.DECELERATING_REVERSE: (DriveState.DECELERATING, _R),
    State.DC_BRAKING: (DriveState.BRAKING, None),
    State.FAULT: (DriveState.FAULT, None),
    State.EMERGENCY_STOP: (DriveState.EMERGENCY_STOPPED, None),
}
"""Manual 2.4.6."""

STOPS = {Stop.STOP: Operation.STOP, Stop.QUICK_STOP: Operation.EMERGENCY_STOP, Stop.JOG_STOP: Operation.JOG_STOP}
STOP_OPERATIONS = frozenset(STOPS.values())
MOVING = frozenset(
    {
        Operation.RUN_FORWARD, Operation.RUN_REVERSE, Operation.JOG_FORWARD, Operation.JOG_REVERSE,
        Operation.RUN_FORWARD_AT, Operation.RUN_REVERSE_AT, Operation.JOG_FORWARD_AT, Operation.JOG_REVERSE_AT,
    }
)  # fmt: skip

RESPONSES = {
    1: "drives.sifang_response_1",
    2: "drives.sifang_response_2",
    3: "drives.sifang_response_3",
    4: "drives.sifang_response_4",
    6: "drives.sifang_response_6",
    7: "drives.sifang_response_7",
    8: "drives.sifang_response_8",
}
"""Manual 2.4.5; the codec lets no other code through."""


def effect_of(request: Any, operation: Operation) -> Effect:
    if operation in MOVING:
        return Effect.MOTION
    if operation is Operation.NONE:
        return Effect.SETTING if isinstance(request, (WriteParameter, Control)) else Effect.NONE
    pure_stop = isinstance(request, Control) and operation in STOP_OPERATIONS and request.data == 0
    return Effect.STOP if pure_stop else Effect.SETTING


def fence_keys(profile: DriveProfile) -> list[tuple[int, int]]:
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
