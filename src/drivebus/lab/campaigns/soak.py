"""``soak`` (G13): 24 h of virtual time, 31 drives on one line, users who start and stop, and everything going wrong.

One seed is one day with one family, the families in turn; every seed runs in a process of its own. The line is made
good again every hour: then every drive must be found as it is.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from random import Random

from drivebus.drives.state import DriveState
from drivebus.lab.campaign import Campaign, Part, Session
from drivebus.lab.kinds import KINDS, Kind
from drivebus.lab.world.stand import Stand
from drivebus.lab.world.wishes import Wish
from drivebus.sim.motor import Trip

DRIVES = 31
DAY_H = 24
HOUR_S = 3600.0
QUIET_S = 180.0
"""The end of each hour: nothing goes wrong any more, and the truth must be known."""
PERIOD_S = 4.0
"""Of each poll of state, frequency and faults: 31 drives at 9,600 baud (the DZB100 at 4,800) fill the line."""
EVENT_S, WISH_S = 45.0, 20.0
"""Mean time between two things that go wrong, and between two wishes."""
WEATHERS = (
    "clean",
    "clean",
    "bytes",
    "lossy,bytes",
    "late=0.1:0.12,bytes",
    "batches",
    "noisy",
    "duplicate=0.05",
    "late=0.02:3",
)
TURNING = frozenset(
    {DriveState.RUNNING, DriveState.ACCELERATING, DriveState.DECELERATING, DriveState.JOGGING, DriveState.BRAKING}
)


class Day:
    """One line for some hours."""

    def __init__(self, session: Session, kind: Kind, seed: int) -> None:
        self.session, self.kind, self.chance = session, kind, Random(f"soak/{seed}")
        lowest = 0 if kind.model == "c320" else 1
        self.stand = Stand(session, kind, range(lowest, lowest + DRIVES), seed=seed, name=f"{kind.name}/{seed}")
        self.addresses = list(self.stand.drives)
        for address in self.addresses:
            self.stand.monitor(address, ("output_frequency",) if kind.tells else None, period_s=PERIOD_S)

    def hour(self) -> None:
        """Trouble for most of an hour, then quiet."""
        loop, wishes = self.stand.loop, list[Wish]()
        end = loop.time() + HOUR_S - QUIET_S
        event, wish = self._next(EVENT_S), self._next(WISH_S)
        while (at := min(event, wish)) < end:
            self.stand.run(at - loop.time())
            if event <= wish:
                self._trouble()
                event = self._next(EVENT_S)
            else:
                wishes = [one for one in wishes if not one.over] + [self._wish()]
                wish = self._next(WISH_S)
        self.stand.run(end - loop.time())
        self._calm()
        self.stand.finish(*wishes, within_s=QUIET_S - 60.0)
        self.stand.run(end + QUIET_S - loop.time())
        self._truth()

    def _next(self, mean_s: float) -> float:
        return self.stand.loop.time() + self.chance.expovariate(1.0 / mean_s)

    def _wish(self) -> Wish:
        chance, stand = self.chance, self.stand
        address = chance.choice(self.addresses)
        match chance.randrange(6):
            case 0 | 1:
                return stand.wish(address, "run", chance.choice((5.0, 12.0, 20.0)))
            case 2 | 3:
                return stand.wish(address, "stop")
            case 4:
                return stand.wish(address, "set_frequency", chance.choice((5.0, 12.0, 20.0)))
            case _:
                return stand.wish(address, "reset_fault")

    def _trouble(self) -> None:
        """One more thing goes wrong, or right again."""
        chance, stand = self.chance, self.stand
        station = stand.station(chance.choice(self.addresses))
        kind = chance.randrange(11)
        self.session.count(f"trouble {kind:02d}")
        match kind:
            case 0 | 1:
                station.faults.silent = not station.faults.silent
            case 2:
                station.faults.mute = not station.faults.mute
            case 3:
                station.trip(chance.choice(list(Trip)))
            case 4:
                station.power_cycle(chance.uniform(0.5, 20.0))
            case 5 | 6:
                stand.bench.weather = chance.choice(WEATHERS)
            case 7:
                station.press_stop()
            case 8:
                station.faults.slow_s = chance.choice((0.0, 0.0, 0.01, 0.3))
            case 9:
                station.faults.late_s.append(chance.uniform(0.1, 2.0))
            case _:
                self._pull(chance.uniform(0.1, 20.0))

    def _pull(self, seconds: float) -> None:
        self.stand.unplug()
        self.stand.run(seconds)
        self.stand.replug()

    def _calm(self) -> None:
        self.stand.bench.weather = "clean"
        for address in self.addresses:
            station = self.stand.station(address)
            station.faults = replace(station.faults, silent=False, mute=False, slow_s=0.0, late_s=[])

    def _truth(self) -> None:
        """After quiet every drive that can tell is known as it is."""
        for address, monitor in self.stand.monitors.items():
            state = monitor.status().state
            on = self.stand.station(address).motor.energised
            if self.kind.tells and (state is DriveState.UNKNOWN or (state in TURNING) is not on):
                self.stand.witness.violation(
                    f"after quiet {address} is called {state}, its motor is {'on' if on else 'off'}"
                )


def one_day(seed: int, hours: int, listener: Callable[[str], None] | None = None) -> Part:
    """One seed, in a process of its own."""
    session = Session("soak", seed, hours, listener=listener)
    kind = KINDS[seed % len(KINDS)]
    began, pages = time.process_time(), list[int]()
    day = Day(session, kind, seed)
    for _ in range(hours):
        day.hour()
        session.did()
        pages.append(_resident())
    witness = day.stand.witness
    day.stand.close()
    session.counts["requests"] += witness.frames
    session.counts["replies believed"] += witness.accepted
    session.figures[f"seed {seed}"] = f"{kind.name}: {witness.frames} requests, trace {session.digest[:16]}"
    factor = hours * HOUR_S / (time.process_time() - began)  # of a processor's seconds: others may use it too
    session.machine[f"seed {seed}"] = {"real_time_factor": round(factor), **_growth(pages)}
    return session.part()


def _growth(pages: list[int]) -> dict[str, float]:
    """Of the memory at the end of each hour, since the first one and since noon, when all that is bounded is full."""
    since = {"rss_growth_percent": pages[0], "rss_growth_since_noon_percent": pages[len(pages) // 2 - 1]}
    return {name: round(100 * (pages[-1] - first) / max(first, 1), 2) for name, first in since.items()}


def _resident() -> int:
    """Pages of this process that are in memory; 0 where the system doesn't tell."""
    try:
        return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except OSError:
        return 0


def run(session: Session) -> None:
    """A day a seed, as many at once as there are cores; the last one may be shorter."""
    days = [
        (session.seed + number, min(DAY_H, session.budget - number * DAY_H))
        for number in range(-(-session.budget // DAY_H))
    ]
    if session.listener is not None or len(days) == 1:
        for seed, hours in days:
            session.merge(one_day(seed, hours, session.listener))
        return
    with ProcessPoolExecutor(os.cpu_count(), max_tasks_per_child=1) as pool:
        for part in pool.map(one_day, *zip(*days, strict=True)):
            session.merge(part)


CAMPAIGN = Campaign("soak", "virtual hours", ("G13", "I1-I12"), full=20 * DAY_H, slice=1, run=run)
