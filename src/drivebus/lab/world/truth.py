"""What users are shown, against what is: ages of readings, and the sizes of everything."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from drivebus.reading import Quality

if TYPE_CHECKING:
    from drivebus.lab.world.stand import Stand

MOST_TIMEOUT_S = 0.4
"""The longest time to answer of any family at the campaigns' baud rates (ruling 12 adds it to the age)."""
MOST = {"tasks": 400, "queued requests": 400, "events on the wire": 4000}
"""I12, for up to 31 drives under load."""


def inspect(stand: Stand) -> None:
    """I4, I8, I12, from outside, at this moment."""
    violation = stand.witness.violation
    for failed in stand.loop.failed:
        violation(f"I8 {failed.get('message')}: {failed.get('exception')!r}")
    stand.loop.failed.clear()
    for address, monitor in stand.monitors.items():
        check_ages(stand, address, monitor)
    sizes = (len(stand.loop.tasks), len(stand.bus.core.scheduler), len(stand.bench.wire._events))
    for (what, most), size in zip(MOST.items(), sizes, strict=True):
        if size > most:
            violation(f"I12 {size} {what}")


def check_ages(stand: Stand, address: int, monitor: Any) -> None:
    """I4: nothing is called good that is older than max(3 x period, 1 s) + timeout (ruling 12)."""
    now, signals = stand.loop.time(), stand.drives[address].profile.signals
    for name, reading in monitor.status().readings.items():
        if reading.quality is Quality.GOOD:
            age = reading.age_s(now)
            if age is None or age > max(3 * signals[name].period_s, 3 * stand.period_s, 1.0) + MOST_TIMEOUT_S:
                stand.witness.violation(f"I4 {name} of {address} is called good at an age of {age} s")
