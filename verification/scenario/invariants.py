"""What users are shown, against what is: ages of readings, and the sizes of everything."""

from __future__ import annotations

import gc
from collections import deque
from math import inf
from typing import TYPE_CHECKING, Any

from drivebus.values import Quality

if TYPE_CHECKING:
    from verification.scenario.scenario import Scenario

LONGEST_REPLY_TIMEOUT_S = 0.4
"""The longest time to answer of any family at the campaigns' baud rates (ruling 12 adds it to the age)."""
MAX_RETAINED = {"frames are remembered": 300, "entries are kept in one place": 600}
"""I12, of a bus of 31 drives: 512 prepared reads of each are the longest list."""
MAX_ALIVE = {"tasks": 400, "queued requests": 400, "events on the wire": 4000}
"""I12, for up to 31 drives under load."""


def check_invariants(stand: Scenario) -> None:
    """I4, I8, I12, from outside, at this moment."""
    violation = stand.oracle.violation
    for failed in stand.loop.failed:
        violation(f"I8 {failed.get('message')}: {failed.get('exception')!r}")
    stand.loop.failed.clear()
    for address, monitor in stand.monitors.items():
        check_ages(stand, address, monitor)
    sizes = (len(stand.loop.tasks), len(stand.bus.core.scheduler), len(stand.bench.wire._events))
    for (what, most), size in zip(MAX_ALIVE.items(), sizes, strict=True):
        if size > most:
            violation(f"I12 {size} {what}")


def check_ages(stand: Scenario, address: int, monitor: Any) -> None:
    """I4: nothing is called good that is older than max(3 x period, 1 s) + timeout.

    Its age is the reading's own time's, and never less than the time since the drive was last heard on the copper.
    """
    now, signals = stand.loop.time(), stand.drives[address].profile.signals
    silent_s = now - stand.oracle.last_delivery_at.get(address, -inf)
    for name, reading in monitor.status().readings.items():
        if reading.quality is Quality.GOOD:
            age = inf if reading.source_time is None else max(now - reading.source_time, silent_s)
            if age > max(3 * signals[name].period_s, 3 * stand.period_s, 1.0) + LONGEST_REPLY_TIMEOUT_S:
                stand.oracle.violation(f"I4 {name} of {address} is called good at an age of {age} s")


def check_memory(stand: Scenario) -> None:
    """I12: how much the bus keeps, wherever it keeps it."""
    for (what, most), size in zip(MAX_RETAINED.items(), count_retained_objects(stand.bus.core), strict=True):
        if size > most:
            stand.oracle.violation(f"I12 {size} {what}")


def count_retained_objects(core: object) -> tuple[int, int]:
    """Count the prepared requests reachable over the bus's own objects and containers; and the longest container."""
    seen, waiting, jobs, longest = {id(core)}, [core], 0, 0
    while waiting:
        for one in gc.get_referents(waiting.pop()):
            kind = type(one)
            if id(one) not in seen and (kind in _CONTAINERS or kind.__module__.startswith("drivebus.bus")):
                seen.add(id(one))
                waiting.append(one)
                jobs += kind.__name__.startswith("Prepared")
                longest = max(longest, len(one) if kind in _CONTAINERS else 0)
    return jobs, longest


_CONTAINERS = frozenset({list, tuple, dict, set, deque})
