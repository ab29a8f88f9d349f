"""What users were told, against the motors: outcome words, ages of readings, and the sizes of everything."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from drivebus.lab.wishes import Wish
from drivebus.reading import Quality

if TYPE_CHECKING:
    from drivebus.lab.stand import Stand

UNSENT = frozenset({"GateError", "LimitError", "PreflightError", "CapabilityError", "Expired", "WearBudget"})
"""Errors that promise: nothing was sent that acts."""
MOST_TIMEOUT_S = 0.4
"""The longest time to answer of any family at the campaigns' baud rates (ruling 12 adds it to the age)."""
MOST = {"tasks": 400, "queued requests": 400, "events on the wire": 4000}
"""I12, for up to 31 drives under load."""


def check_outcome(
    wish: Wish, station: Any, tells: bool, moved_since: bool, violation: Callable[[str], None]
) -> None:  # fmt: skip
    """``tells``: the drive can say whether it runs. ``moved_since``: somebody wished for motion while this went on."""
    if wish.word in UNSENT and wish.executions:
        violation(f"{wish}: {wish.word}, but the motor was switched on for it")
    if wish.word != "confirmed" or station.faults.stuck:
        return
    if not tells and wish.what in ("run", "stop"):
        violation(f"{wish}: confirmed by a drive that can't tell")
    if wish.stops and station.motor.energised and not moved_since:
        violation(f"{wish}: confirmed, but the motor is on")
    if wish.what == "run" and not wish.executions and not station.motor.energised:
        violation(f"{wish}: confirmed, but it never switched the motor on")


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
