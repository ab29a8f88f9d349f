"""``soak``: 24 h of virtual time, 31 drives on one line, users who start and stop, and everything going wrong.

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
from drivebus.simulator.motor import Trip
from verification.campaign import Campaign, CampaignRun, PartResult
from verification.drive_variants import DRIVE_VARIANTS, DriveVariant
from verification.scenario.scenario import Scenario
from verification.scenario.user_command import UserCommand

SOAK_DRIVE_COUNT = 31
HOURS_PER_DAY = 24
HOUR_S = 3600.0
QUIET_PHASE_S = 180.0
"""The end of each hour: nothing goes wrong any more, and the truth must be known."""
SOAK_POLL_PERIOD_S = 4.0
"""Of each poll of state, frequency and faults: 31 drives at 9,600 baud (the DZB100 at 4,800) fill the line."""
MEAN_TROUBLE_INTERVAL_S, MEAN_COMMAND_INTERVAL_S = 45.0, 20.0
"""Mean time between two things that go wrong, and between two wishes."""
SOAK_LINE_QUALITIES = (
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
TURNING_STATES = frozenset(
    {DriveState.RUNNING, DriveState.ACCELERATING, DriveState.DECELERATING, DriveState.JOGGING, DriveState.BRAKING}
)


class SoakDay:
    """One line for some hours."""

    def __init__(self, session: CampaignRun, kind: DriveVariant, seed: int) -> None:
        self.session, self.kind, self.rng = session, kind, Random(f"soak/{seed}")
        lowest = 0 if kind.model == "c320" else 1
        self.scenario = Scenario(
            session, kind, range(lowest, lowest + SOAK_DRIVE_COUNT), seed=seed, name=f"{kind.name}/{seed}"
        )
        self.addresses = list(self.scenario.drives)
        for address in self.addresses:
            self.scenario.monitor(
                address, ("output_frequency",) if kind.reports_running else None, period_s=SOAK_POLL_PERIOD_S
            )

    def run_hour(self) -> None:
        """Trouble for most of an hour, then quiet."""
        loop, commands = self.scenario.loop, list[UserCommand]()
        end = loop.time() + HOUR_S - QUIET_PHASE_S
        event, command = self._next_time(MEAN_TROUBLE_INTERVAL_S), self._next_time(MEAN_COMMAND_INTERVAL_S)
        while (at := min(event, command)) < end:
            self.scenario.run(at - loop.time())
            if event <= command:
                self._disturb()
                event = self._next_time(MEAN_TROUBLE_INTERVAL_S)
            else:
                commands = [one for one in commands if not one.is_ended] + [self._random_command()]
                command = self._next_time(MEAN_COMMAND_INTERVAL_S)
        self.scenario.run(end - loop.time())
        self._restore_line()
        self.scenario.finish(*commands, within_s=QUIET_PHASE_S - 60.0)
        self.scenario.run(end + QUIET_PHASE_S - loop.time())
        self._check_final_state()

    def _next_time(self, mean_s: float) -> float:
        return self.scenario.loop.time() + self.rng.expovariate(1.0 / mean_s)

    def _random_command(self) -> UserCommand:
        chance, stand = self.rng, self.scenario
        address = chance.choice(self.addresses)
        match chance.randrange(6):
            case 0 | 1:
                return stand.command(address, "run", chance.choice((5.0, 12.0, 20.0)))
            case 2 | 3:
                return stand.command(address, "stop")
            case 4:
                return stand.command(address, "set_frequency", chance.choice((5.0, 12.0, 20.0)))
            case _:
                return stand.command(address, "reset_fault")

    def _disturb(self) -> None:
        """One more thing goes wrong, or right again."""
        chance, stand = self.rng, self.scenario
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
                stand.bench.line_quality = chance.choice(SOAK_LINE_QUALITIES)
            case 7:
                station.keypad_stop()
            case 8:
                station.faults.added_delay_s = chance.choice((0.0, 0.0, 0.01, 0.3))
            case 9:
                station.faults.next_added_delays_s.append(chance.uniform(0.1, 2.0))
            case _:
                self._unplug_for(chance.uniform(0.1, 20.0))

    def _unplug_for(self, seconds: float) -> None:
        self.scenario.unplug()
        self.scenario.run(seconds)
        self.scenario.replug()

    def _restore_line(self) -> None:
        self.scenario.bench.line_quality = "clean"
        for address in self.addresses:
            station = self.scenario.station(address)
            station.faults = replace(
                station.faults, silent=False, mute=False, added_delay_s=0.0, next_added_delays_s=[]
            )

    def _check_final_state(self) -> None:
        """After quiet every drive that can tell is known as it is."""
        for address, monitor in self.scenario.monitors.items():
            state = monitor.status().state
            on = self.scenario.station(address).motor.energised
            if self.kind.reports_running and (state is DriveState.UNKNOWN or (state in TURNING_STATES) is not on):
                self.scenario.oracle.violation(
                    f"after quiet {address} is called {state}, its motor is {'on' if on else 'off'}"
                )


def run_day(seed: int, hours: int, listener: Callable[[str], None] | None = None) -> PartResult:
    """One seed, in a process of its own."""
    session = CampaignRun("soak", seed, hours, listener=listener)
    kind = DRIVE_VARIANTS[seed % len(DRIVE_VARIANTS)]
    began, pages = time.process_time(), list[int]()
    day = SoakDay(session, kind, seed)
    for _ in range(hours):
        day.run_hour()
        session.add_trials()
        pages.append(_resident_pages())
    witness = day.scenario.oracle
    day.scenario.close()
    session.counts["requests"] += witness.request_count
    session.counts["replies believed"] += witness.accepted_count
    session.figures[f"seed {seed}"] = f"{kind.name}: {witness.request_count} requests, trace {session.digest[:16]}"
    factor = hours * HOUR_S / (time.process_time() - began)  # of a processor's seconds: others may use it too
    session.machine[f"seed {seed}"] = {"real_time_factor": round(factor), **_memory_growth(pages)}
    return session.result()


def _memory_growth(pages: list[int]) -> dict[str, float]:
    """Of the memory at the end of each hour, since the first one and since noon, when all that is bounded is full."""
    since = {"rss_growth_percent": pages[0], "rss_growth_since_noon_percent": pages[len(pages) // 2 - 1]}
    return {name: round(100 * (pages[-1] - first) / max(first, 1), 2) for name, first in since.items()}


def _resident_pages() -> int:
    """Pages of this process that are in memory; 0 where the system doesn't tell."""
    try:
        return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except OSError:
        return 0


def run(session: CampaignRun) -> None:
    """A day a seed, as many at once as there are cores; the last one may be shorter."""
    days = [
        (session.seed + number, min(HOURS_PER_DAY, session.budget - number * HOURS_PER_DAY))
        for number in range(-(-session.budget // HOURS_PER_DAY))
    ]
    if session.listener is not None or len(days) == 1:
        for seed, hours in days:
            session.merge(run_day(seed, hours, session.listener))
        return
    with ProcessPoolExecutor(os.cpu_count(), max_tasks_per_child=1) as pool:
        for part in pool.map(run_day, *zip(*days, strict=True)):
            session.merge(part)


CAMPAIGN = Campaign(
    name="soak",
    summary={"en": "A day with everything going wrong.", "zh": "出尽状况的一天。"},
    unit="virtual hours",
    evidence_for=("I1-I12",),
    full_budget=20 * HOURS_PER_DAY,
    ci_budget=1,
    run=run,
)
