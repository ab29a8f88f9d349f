"""Which registers of a Modbus model are read together, and which pairs make fences (F22, ruling 2). Pure."""

from __future__ import annotations

from dataclasses import replace

from drivebus.drives.dialects.base import signals_by_index
from drivebus.errors import ConfigurationError
from drivebus.profiles.model import DriveProfile
from drivebus.protocols.modbus import ReadRegisters

SYNC_READ_COUNT = 2
"""Without FC08 a fence is told by its count (ruling 2), so no other read ever has this count."""
MAX_MERGE_PERIOD_RATIO = 4.0
"""Registers whose periods differ by more are read apart."""


def merge_reads(
    address: int, wanted: dict[int, float], max_read: int, *, reserve_sync_count: bool
) -> tuple[tuple[ReadRegisters, float], ...]:
    """Runs of touching registers within the model's limit, at the shortest period of the run.

    ``keep_fence_count``: fences are told by their count, so no other read may have it.
    """
    runs: list[tuple[ReadRegisters, float]] = []
    for register, period in sorted(wanted.items()):
        last = runs[-1] if runs else None
        if last is not None and _can_merge(last, register, period, max_read):
            runs[-1] = replace(last[0], count=last[0].count + 1), min(last[1], period)
        else:
            runs.append((ReadRegisters(address, register, 1), period))
    if not reserve_sync_count:
        return tuple(runs)
    return tuple((part, period) for request, period in runs for part in _split_sync_count(request))


def _can_merge(run: tuple[ReadRegisters, float], register: int, period: float, max_read: int) -> bool:
    """Two more bytes cost less than a frame of their own, unless they are wanted far less often."""
    request, shortest = run
    touches = register == request.register + request.count and request.count < max_read
    return touches and max(period, shortest) <= MAX_MERGE_PERIOD_RATIO * min(period, shortest)


def _split_sync_count(request: ReadRegisters) -> tuple[ReadRegisters, ...]:
    if request.count != SYNC_READ_COUNT:
        return (request,)
    return replace(request, count=1), replace(request, register=request.register + 1, count=1)


def sync_register_pairs(profile: DriveProfile) -> tuple[int, ...]:
    """First registers of touching pairs that are read anyway: around preconditions and ramps (ruling 2)."""
    named = [p.notation for p in profile.preconditions] + list(profile.ramp_notations or ())
    wanted = {profile.parameters[n].locator[1] for n in named if n in profile.parameters}
    wanted |= set(signals_by_index(profile, "holding"))
    known = {p.locator[1] for p in profile.parameters.values() if p.readable and p.locator[0] == "holding"} | wanted
    pairs: list[int] = []
    for index in sorted(known):
        touches = index + 1 in known and (index in wanted or index + 1 in wanted)
        if touches and (not pairs or index > pairs[-1] + 1):
            pairs.append(index)
    if not pairs:
        raise ConfigurationError("drives.no_fence", model=profile.model)
    return tuple(pairs)
