"""Kernel timers that can't be had, and a bus's own clock that says the same for long."""

from __future__ import annotations

import asyncio
import errno
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from drivebus.bus import Bus
from drivebus.bus import timer as timers
from drivebus.drives import Drive, MemoryStore
from drivebus.errors import DrivebusError
from drivebus.ports import open_port
from drivebus.simulator import timer
from drivebus.testing.virtual_time import running
from verification.campaign import CampaignRun
from verification.drive_variants import VC660
from verification.fault_injection.port_failures import PORT_SUCCESS_WORDS, PortFailureScenario

TIMER_TEST_LINK = "sim://vc660@1?baud=38400&ramp=1&echo=off"
CLOCK_STALL_S = 3.0
"""So long the clock says the same."""
MAX_CLOCK_READS = 50_000
"""Asked more often meanwhile, it is not waited for but spun upon: nobody else gets a turn."""
JUDGED_TEXTS = ("G12", "I8", "has no end")
"""What can be held against a bus that is told a wrong time; its gaps and ages can't."""


class ScarceTimers:
    """Timers and places in the selector, counted in one row; the ``nth`` is one too many."""

    def __init__(self, nth: int) -> None:
        self.nth, self.calls = nth, 0

    def of(self, plain: Callable[..., Any]) -> Callable[..., Any]:
        def taken(*given: Any) -> Any:
            self.calls += 1
            if self.calls == self.nth:
                raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))
            return plain(*given)

        return taken


def fail_kernel_timers(session: CampaignRun, nth: int) -> int:
    """A short life on an asyncio loop of this system, in its own time. How many were asked for."""
    scarce, before = ScarceTimers(nth), _open_files()
    places: tuple[Any, ...] = (timers, timer)
    plain = [module.TimerFd for module in places]
    for module, made in zip(places, plain, strict=True):
        module.TimerFd = scarce.of(made)
    try:
        word = asyncio.run(asyncio.wait_for(_run_briefly(scarce), 20.0))
        if word not in PORT_SUCCESS_WORDS:
            session.violation(f"G12 without timer {nth} a stop ended as {word}")
    except Exception as error:
        session.violation(f"G12 without timer {nth}: {type(error).__name__}: {error}")
    finally:
        for module, made in zip(places, plain, strict=True):
            module.TimerFd = made
    if _open_files() != before:
        session.violation(f"G12 without timer {nth} {_open_files() - before} files stayed open")
    return scarce.calls


async def _run_briefly(scarce: ScarceTimers) -> str:
    loop: Any = asyncio.get_running_loop()
    loop.add_reader = scarce.of(loop.add_reader)
    async with Bus(open_port(TIMER_TEST_LINK)) as bus:
        drive = Drive(bus, "vc660", 1, store=MemoryStore())
        await drive.status()
        await drive.run(5.0)
        return str((await drive.stop()).status)


def _open_files() -> int:
    """0 where the system does not tell."""
    listed = Path("/proc/self/fd")
    return len(list(listed.iterdir())) if listed.exists() else 0


class StalledClock:
    """From its ``nth`` reading on it says the same for CLOCK_STALL_S, then the truth again."""

    def __init__(self, now: Callable[[], float], nth: int) -> None:
        self._now, self.nth, self.reads, self._stuck_at = now, nth, 0, 0.0
        self.stalled_reads = 0
        """Readings that told nothing new."""

    def __call__(self) -> float:
        self.reads += 1
        now = self._now()
        if self.reads == self.nth:
            self._stuck_at = now
        if (
            not self.reads >= self.nth > 0
            or now >= self._stuck_at + CLOCK_STALL_S
            or self.stalled_reads > MAX_CLOCK_READS
        ):
            return now
        self.stalled_reads += 1
        return self._stuck_at


class UntimedPortScenario(PortFailureScenario):
    """Whose readings nobody judges by their age."""

    def monitor(self, address: int) -> None:
        with running(self.loop):
            self.scenario.drives[address].monitor(period_s=0.5)


def stall_clock(session: CampaignRun, nth: int) -> int:
    """How often the bus read its clock."""
    own = CampaignRun("failures", session.seed, 1)
    story = UntimedPortScenario(own, VC660, f"clock/{nth}")
    clock = StalledClock(story.loop.time, nth)
    story.scenario.bus._clock = clock
    story.scenario.oracle.on_reply_accepted = lambda answer: None  # type: ignore[method-assign]
    try:
        story.run()
        story.scenario.run(CLOCK_STALL_S)
        reads = clock.reads
        if clock.stalled_reads > MAX_CLOCK_READS:
            story.violation("a clock that stands still is spun upon")
        if not story.check_works():
            story.violation("the bus does not work again")
        story.scenario.close()
    except DrivebusError as error:
        reads = clock.reads
        story.violation(f"{type(error).__name__} escaped: {error}")
    for text in own.violations:
        if any(held in text for held in JUDGED_TEXTS):
            session.violation(text)
    return reads
