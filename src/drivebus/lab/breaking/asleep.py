"""The host does not run for a while: stopped (SIGSTOP, a frozen machine) or suspended. Drives and wire go on.

What comes meanwhile waits in the kernel. After a stop all clocks have gone on; after a suspend only the bus's has
(CLOCK_BOOTTIME), the loop's (CLOCK_MONOTONIC) stood still, and whoever slept by it sleeps on.
"""

from __future__ import annotations

import asyncio
from functools import partial
from random import Random
from typing import Any

from drivebus.bus import timer as timers
from drivebus.drives.state import Outcome
from drivebus.errors import GateError
from drivebus.lab.campaign import Session
from drivebus.lab.kinds import Kind
from drivebus.lab.manual import Does
from drivebus.lab.world.conduct import Frame
from drivebus.lab.world.loop import Timer
from drivebus.lab.world.stand import Stand
from drivebus.lab.world.wishes import Wish
from drivebus.sim.alarm import Alarm

SLEEPS_S = (10.0, 3600.0)
"""Longer than any command may be old."""
BEFORE_S = 0.6
"""Wishes are made within this time before the host falls asleep: some are queued then, some on the wire."""
JOG_END_S = 1.0
"""A jog that the sleep left turning is told to stop so soon after it: the lease of 0.5 s, a frame and its gap."""
RAMP_S = 1
ONE, TURNING, JOGGED = 1, 2, 3


def asleep(stand: Stand, seconds: float, *, suspended: bool, reader_first: bool) -> None:
    """``reader_first``: awake again, the host hears what waits before its alarm rings, else after."""
    port: Any = stand.port
    hear, held = port.hear, list[tuple[bytes, int]]()
    port.hear = lambda data, marks: held.append((data, marks))
    stand.loop.hold_up(seconds, _of_the_bench, lambda timer: suspended and not _of_the_bus(timer))
    port.hear = hear
    if held:
        later = stand.loop.call_soon if reader_first else partial(stand.loop.call_later, 0.0)
        later(hear, b"".join(data for data, _ in held), sum(marks for _, marks in held))


def _of_the_bench(timer: Timer) -> bool:
    return isinstance(getattr(timer.callback, "__self__", None), Alarm)


def _of_the_bus(timer: Timer) -> bool:
    """Its alarm is set on the clock that goes on."""
    return isinstance(getattr(timer.callback, "__self__", None), timers._LoopWaker)


class Night:
    """One line whose host falls asleep over a run, a setpoint, a write, a jog or a stop (RELIABILITY 6.6)."""

    def __init__(self, session: Session, kind: Kind, name: str, chance: Random) -> None:
        self.session, self.kind, self.chance = session, kind, chance
        self.stand = Stand(session, kind, (ONE, TURNING, JOGGED), name=name, seed=chance.randrange(2**31), ramp=RAMP_S)
        self.frames: list[Frame] = []
        self.woke_at = float("inf")
        conduct: Any = self.stand.witness.conduct
        self._asked, conduct.asked = conduct.asked, self._on_frame

    def _on_frame(self, frame: Frame, *more: Any) -> None:
        self._asked(frame, *more)
        self.frames.append(frame)
        wish = frame.wish
        if wish is not None and frame.start >= self.woke_at > wish.at and frame.does in (Does.MOVE, Does.SET):
            self.stand.witness.violation(f"6.6 {frame.does} for {wish} was sent after the sleep")

    def play(self) -> None:
        stand, chance = self.stand, self.chance
        for address in chance.sample((ONE, TURNING, JOGGED), 2):
            stand.monitor(address)
        stand.finish(stand.wish(TURNING, "run", 5.0))
        jog = self._jog() if chance.random() < 0.5 else None
        stand.run(chance.uniform(0.5, 1.0))
        wishes = self._wishes()
        asleep(stand, chance.choice(SLEEPS_S), suspended=chance.random() < 0.5, reader_first=chance.random() < 0.5)
        self.woke_at = stand.loop.time()
        stand.witness.note("awake")
        turning = stand.station(JOGGED).motor.energised
        if chance.random() < 0.5:
            wishes.append(stand.wish(TURNING, "stop"))
        if jog is not None:
            self._jog_ends(turning)
            wishes.append(jog)
        stand.finish(*wishes)
        stand.run(RAMP_S + 1.0)
        for wish in wishes:
            self._ended(wish)
        stand.close()

    def _wishes(self) -> list[Wish]:
        """Before the sleep, at instants of their own."""
        stand, chance = self.stand, self.chance
        stop = chance.random() < 0.3
        wished = {
            chance.uniform(0.0, BEFORE_S): (ONE, "run", 5.0),
            chance.uniform(0.0, BEFORE_S): (TURNING, "stop") if stop else (TURNING, "set_frequency", 3.0),
        }
        wishes, began = list[Wish](), stand.loop.time()
        for at in sorted(wished):
            stand.run(began + at - stand.loop.time())
            wishes.append(stand.wish(*wished[at]))
        stand.run(began + BEFORE_S - stand.loop.time())
        return wishes

    def _jog(self) -> Wish | None:
        if "jog" not in self.stand.drives[JOGGED].profile.capabilities:
            return None
        wish = self.stand.wish_by(self._hold, JOGGED, "jog")
        self.stand.run(2.0)
        return wish

    async def _hold(self) -> Outcome | None:
        """A program that renews whenever it runs."""
        async with self.stand.drives[JOGGED].jog(2.0 if self.kind.model == "dzb100" else None) as lease:
            try:
                while not lease.lost:
                    await asyncio.sleep(0.1)
                    lease.renew()
            except GateError:
                self.session.count("leases lost over the sleep")
        return lease.begun

    def _jog_ends(self, turning: bool) -> None:
        self.stand.run(JOG_END_S)
        stops = (one for one in self.frames if one.does is Does.STOP and one.address == JOGGED)
        if turning and not any(self.woke_at <= one.start for one in stops):
            self.stand.witness.violation(f"T13 a jog goes on {JOG_END_S} s after the sleep")

    def _ended(self, wish: Wish) -> None:
        """Stops are heard, and confirmed or alarmed (G07); what was not sent before is told to be too old."""
        queued = not any(frame.wish is wish for frame in self.frames)
        if not wish.stops and wish.what != "jog" and wish.at < self.woke_at and queued:
            self.session.count(f"asleep over an unsent {wish.what}: {wish.word}")
        told = ("confirmed" if self.kind.tells else "acknowledged", "unknown")
        deeds = self.stand.witness.deeds[wish.address]
        if wish.stops and (wish.word not in told or deeds.stop_heard_at < wish.at or deeds.on):
            motor = "on" if deeds.on else "off"
            self.stand.witness.violation(f"6.6 {wish} ended as {wish.word}, the motor is {motor}")
