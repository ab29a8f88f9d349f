"""``soak``: 24 h of virtual time with 31 drives on one bus, users who start and stop, and all faults.

One seed is one day with one variant, the variants in turn; every seed runs in its own process. The bus is restored
every hour: then the state of every drive must be known and true.
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
from verification.drive_variants import DriveVariant
from verification.families.registry import variants_for
from verification.scenario.scenario import Scenario
from verification.scenario.user_command import UserCommand

COVERED = variants_for("soak")
SOAK_DRIVE_COUNT = 31
HOURS_PER_DAY = 24
HOUR_S = 3600.0
QUIET_PHASE_S = 180.0
"""Time without faults at the end of each hour, in seconds."""
SOAK_POLL_PERIOD_S = 4.0
"""Period of each poll of state, frequency and faults, in seconds: 31 drives at 9,600 baud (DZB100: 4,800) load the bus
fully."""
MEAN_FAULT_INTERVAL_S, MEAN_COMMAND_INTERVAL_S = 45.0, 20.0
"""Mean time between two faults and between two commands, in seconds."""
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
    """Bus that runs for some hours of virtual time."""

    def __init__(self, campaign_run: CampaignRun, variant: DriveVariant, seed: int) -> None:
        self.campaign_run, self.variant, self.rng = campaign_run, variant, Random(f"soak/{seed}")
        lowest = 0 if variant.model == "c320" else 1
        self.scenario = Scenario(
            campaign_run, variant, range(lowest, lowest + SOAK_DRIVE_COUNT), seed=seed, name=f"{variant.name}/{seed}"
        )
        self.addresses = list(self.scenario.drives)
        for address in self.addresses:
            self.scenario.monitor(
                address, ("output_frequency",) if variant.reports_running else None, period_s=SOAK_POLL_PERIOD_S
            )

    def run_hour(self) -> None:
        """Run faults and commands for most of an hour, then check the final state."""
        loop, commands = self.scenario.loop, list[UserCommand]()
        end = loop.time() + HOUR_S - QUIET_PHASE_S
        fault_at, command_at = self._next_time(MEAN_FAULT_INTERVAL_S), self._next_time(MEAN_COMMAND_INTERVAL_S)
        while (at := min(fault_at, command_at)) < end:
            self.scenario.run(at - loop.time())
            if fault_at <= command_at:
                self._disturb()
                fault_at = self._next_time(MEAN_FAULT_INTERVAL_S)
            else:
                commands = [command for command in commands if not command.is_ended] + [self._random_command()]
                command_at = self._next_time(MEAN_COMMAND_INTERVAL_S)
        self.scenario.run(end - loop.time())
        self._restore_line()
        self.scenario.finish(*commands, within_s=QUIET_PHASE_S - 60.0)
        self.scenario.run(end + QUIET_PHASE_S - loop.time())
        self._check_final_state()

    def _next_time(self, mean_s: float) -> float:
        return self.scenario.loop.time() + self.rng.expovariate(1.0 / mean_s)

    def _random_command(self) -> UserCommand:
        rng, scenario = self.rng, self.scenario
        address = rng.choice(self.addresses)
        match rng.randrange(6):
            case 0 | 1:
                return scenario.command(address, "run", rng.choice((5.0, 12.0, 20.0)))
            case 2 | 3:
                return scenario.command(address, "stop")
            case 4:
                return scenario.command(address, "set_frequency", rng.choice((5.0, 12.0, 20.0)))
            case _:
                return scenario.command(address, "reset_fault")

    def _disturb(self) -> None:
        """Apply or clear one random fault."""
        rng, scenario = self.rng, self.scenario
        station = scenario.station(rng.choice(self.addresses))
        kind = rng.randrange(11)
        self.campaign_run.count(f"trouble {kind:02d}")
        match kind:
            case 0 | 1:
                station.faults.silent = not station.faults.silent
            case 2:
                station.faults.mute = not station.faults.mute
            case 3:
                station.trip(rng.choice(list(Trip)))
            case 4:
                station.power_cycle(rng.uniform(0.5, 20.0))
            case 5 | 6:
                scenario.simulated_bus.line_quality = rng.choice(SOAK_LINE_QUALITIES)
            case 7:
                station.keypad_stop()
            case 8:
                station.faults.added_delay_s = rng.choice((0.0, 0.0, 0.01, 0.3))
            case 9:
                station.faults.next_added_delays_s.append(rng.uniform(0.1, 2.0))
            case _:
                self._unplug_for(rng.uniform(0.1, 20.0))

    def _unplug_for(self, seconds: float) -> None:
        self.scenario.unplug()
        self.scenario.run(seconds)
        self.scenario.replug()

    def _restore_line(self) -> None:
        self.scenario.simulated_bus.line_quality = "clean"
        for address in self.addresses:
            station = self.scenario.station(address)
            station.faults = replace(
                station.faults, silent=False, mute=False, added_delay_s=0.0, next_added_delays_s=[]
            )

    def _check_final_state(self) -> None:
        """Check that the state of every drive that reports it is known and true."""
        for address, monitor in self.scenario.monitors.items():
            state = monitor.status().state
            on = self.scenario.station(address).motor.energised
            if self.variant.reports_running and (state is DriveState.UNKNOWN or (state in TURNING_STATES) is not on):
                self.scenario.oracle.violation(
                    f"after quiet {address} is called {state}, its motor is {'on' if on else 'off'}"
                )


def run_day(seed: int, hours: int, listener: Callable[[str], None] | None = None) -> PartResult:
    """Run one seed, in its own process."""
    campaign_run = CampaignRun(campaign="soak", seed=seed, budget=hours, listener=listener)
    variant = COVERED[seed % len(COVERED)]
    began, pages = time.process_time(), list[int]()
    day = SoakDay(campaign_run, variant, seed)
    for _ in range(hours):
        day.run_hour()
        campaign_run.add_trials()
        pages.append(_resident_pages())
    oracle = day.scenario.oracle
    day.scenario.close()
    campaign_run.counts["requests"] += oracle.request_count
    campaign_run.counts["replies accepted"] += oracle.accepted_count
    campaign_run.figures[f"seed {seed}"] = (
        f"{variant.name}: {oracle.request_count} requests, trace {campaign_run.digest[:16]}"
    )
    factor = hours * HOUR_S / (time.process_time() - began)  # of a processor's seconds: others may use it too
    campaign_run.machine[f"seed {seed}"] = {"real_time_factor": round(factor), **_memory_growth(pages)}
    return campaign_run.result()


def _memory_growth(pages: list[int]) -> dict[str, float]:
    """Return the growth of the memory since the first hour, and since noon, when all bounded collections are full."""
    since = {"rss_growth_percent": pages[0], "rss_growth_since_noon_percent": pages[len(pages) // 2 - 1]}
    return {name: round(100 * (pages[-1] - first) / max(first, 1), 2) for name, first in since.items()}


def _resident_pages() -> int:
    """Return the resident memory pages of this process; 0 where the system does not report them."""
    try:
        return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except OSError:
        return 0


def run(campaign_run: CampaignRun) -> None:
    """Run one day a seed, one process a core; the last day may be shorter."""
    days = [
        (campaign_run.seed + number, min(HOURS_PER_DAY, campaign_run.budget - number * HOURS_PER_DAY))
        for number in range(-(-campaign_run.budget // HOURS_PER_DAY))
    ]
    if campaign_run.listener is not None or len(days) == 1:
        for seed, hours in days:
            campaign_run.merge(run_day(seed, hours, campaign_run.listener))
        return
    with ProcessPoolExecutor(os.cpu_count(), max_tasks_per_child=1) as pool:
        for part in pool.map(run_day, *zip(*days, strict=True)):
            campaign_run.merge(part)


CAMPAIGN = Campaign(
    name="soak",
    summary={"en": "A day with every fault.", "zh": "各种故障齐发的一天。"},
    unit="virtual hours",
    evidence_for=("I1-I12",),
    full_budget=20 * HOURS_PER_DAY,
    ci_budget=1,
    run=run,
)
