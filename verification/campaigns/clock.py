"""``clock``: the wall clock jumps by ±1 s, ±1 h, ±10 years and summer time, at random instants.

Each trial runs twice with the same seed, under a steady and under a jumping wall clock: frames, outcomes, readings and
their times must be the same, and captures too, except their label. The EEPROM budget is used up under a clock that
jumps around midnight, and a host sleeps with queued commands.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Any

from drivebus.drives import Drive, DriveLimits, MemoryStore
from drivebus.drives.state import DriveStatus
from drivebus.ports.recording import RecordingPort
from drivebus.testing.virtual_time import VirtualLoop
from verification.campaign import Campaign, CampaignRun
from verification.drive_variants import DriveVariant
from verification.families.campaigns import written_parameter
from verification.families.registry import variants_for
from verification.fault_injection.clocks import (
    CLOCK_JUMPS_S,
    HostSleepScenario,
    JumpingWallClock,
    before_midnight,
    clock_readers,
    installed_clock,
)
from verification.report import PACKAGE_FOLDER
from verification.scenario.scenario import Scenario

COVERED = variants_for("clock")
CLOCK_READER = {("clock.py", "datetime.now")}
"""Only place in the product that reads the wall clock."""
JUMPS_PER_TRIAL = 10
"""Jumps of one trial."""
TRIAL_DURATION_S, MEAN_COMMAND_PAUSE_S = 20.0, 1.0
CLOCK_LINE_QUALITIES = ("clean", "clean", "bytes", "loss=0.05", "late=0.05:0.3", "noisy")
EEPROM_WRITES_PER_DAY = 3
ScriptedEvent = tuple[float, str, tuple[Any, ...]]


class ClockTrial:
    """Run of a trial; ``jumps``: the wall clock jumps."""

    def __init__(
        self, campaign_run: CampaignRun, variant: DriveVariant, name: str, seed: int, capture: Path, *, jumps: bool
    ) -> None:
        self.lines: list[str] = []
        self.campaign_run = CampaignRun(campaign="clock", seed=campaign_run.seed, budget=1, listener=self.lines.append)
        rng, self.jumps = Random(seed), jumps
        self.clock = JumpingWallClock(
            before_midnight(rng.uniform(0.0, 2 * TRIAL_DURATION_S)), (loop := VirtualLoop()).time
        )
        self.recorder: RecordingPort | None = None
        self.newest: Counter[tuple[int, str]] = Counter()

        def record(port: Any) -> RecordingPort:
            self.recorder = RecordingPort(port, capture)
            return self.recorder

        with installed_clock(self.clock):
            self.scenario = Scenario(
                self.campaign_run, variant, (1, 2), loop=loop, name=name, seed=seed, wrap_port=record
            )
            self.scenario.simulated_bus.line_quality = rng.choice(CLOCK_LINE_QUALITIES)
            for address in self.scenario.drives:
                self._record_samples(address)

    def _record_samples(self, address: int) -> None:
        def sampled(status: DriveStatus) -> None:
            for name, reading in status.readings.items():
                if reading.source_time is not None and reading.source_time != self.newest[address, name]:
                    self._on_sample(address, name, reading)

        monitor = self.scenario.monitor(address)
        monitor._on_change = sampled

    def _on_sample(self, address: int, name: str, reading: Any) -> None:
        """Check that samples come in order and none has a time in the future."""
        at = reading.source_time
        if not self.newest[address, name] < at <= self.scenario.loop.time():
            self.scenario.oracle.violation(
                f"order of samples: {name} of {address} at {at} s came after one at {self.newest[address, name]} s"
            )
        self.newest[address, name] = at
        self.scenario.oracle.trace(f"~ {address} {name} {reading.value} {at:.6f}")

    def play(self, events: list[ScriptedEvent]) -> None:
        with installed_clock(self.clock):
            for at, what, arguments in events:
                self.scenario.run(at - self.scenario.loop.time())
                if what != "jump":
                    keywords = {"save": True} if what == "write" else {}
                    self.scenario.command(arguments[0], what, *arguments[1:], **keywords)
                elif self.jumps:
                    self.clock.jump(arguments[0])
            self.scenario.run(TRIAL_DURATION_S - self.scenario.loop.time())
            self.scenario.close()
        assert self.recorder is not None
        self.recorder.end_capture()


def random_script(variant: DriveVariant, rng: Random, jumps: list[str]) -> list[ScriptedEvent]:
    """Return the events of a trial with their times: commands, and jumps at independent instants."""
    events: list[ScriptedEvent] = [(rng.uniform(0.2, TRIAL_DURATION_S), "jump", (name,)) for name in jumps]
    at = rng.expovariate(1 / MEAN_COMMAND_PAUSE_S)
    while at < TRIAL_DURATION_S:
        address, hz = rng.choice((1, 2)), rng.choice((5.0, 12.0))
        value = {written_parameter(variant.model).notation: float(rng.randrange(1, 40))}
        commands: tuple[tuple[str, tuple[Any, ...]], ...] = (
            ("run", (address, hz)),
            ("stop", (address,)),
            ("set_frequency", (address, hz)),
            ("write", (address, value)),
            ("reset_fault", (address,)),
        )
        events.append((at, *rng.choice(commands)))
        at += rng.expovariate(1 / MEAN_COMMAND_PAUSE_S)
    return sorted(events, key=lambda event: event[0])


def compare_clocks(
    campaign_run: CampaignRun, variant: DriveVariant, number: int, jumps: list[str], folder: Path
) -> None:
    """Run a trial under both clocks and compare the runs."""
    rng = campaign_run.rng(variant.name, number)
    events, seed, name = random_script(variant, rng, jumps), rng.randrange(2**31), f"{variant.name}/{number}"
    trials = [
        ClockTrial(campaign_run, variant, name, seed, folder / f"{number}-{jumping}", jumps=jumping)
        for jumping in (False, True)
    ]
    for trial in trials:
        trial.play(events)
        for text in trial.campaign_run.violations:
            campaign_run.violation(text)
    steady, jumping = (trial.lines for trial in trials)
    for line in jumping:
        campaign_run.trace(line)
    difference = next((pair for pair in zip(steady, jumping, strict=False) if pair[0] != pair[1]), None)
    if difference is not None or len(steady) != len(jumping):
        campaign_run.violation(
            f"wall clock: {name}, seed {campaign_run.seed}: steady {difference and difference[0]}, jumping {difference}"
        )
    records = [(folder / f"{number}-{jumping}").read_bytes().partition(b"\n")[2] for jumping in (False, True)]
    if records[0] != records[1] or not records[0]:
        campaign_run.violation(f"wall clock: {name}, seed {campaign_run.seed}: the captures differ")
    campaign_run.counts.update(trials[1].campaign_run.counts)
    campaign_run.count("samples", sum("~" in line for line in jumping))
    campaign_run.count("frames", trials[1].scenario.oracle.request_count)


class EepromBudgetTrial:
    """Saves under a jumping clock: only a day later than all before renews the budget."""

    def __init__(self, campaign_run: CampaignRun, variant: DriveVariant, name: str, rng: Random) -> None:
        self.campaign_run, self.variant, self.chance = campaign_run, variant, rng
        loop = VirtualLoop()
        self.clock = JumpingWallClock(before_midnight(rng.uniform(0.0, 30.0)), loop.time)
        self.scenario = Scenario(campaign_run, variant, (1,), loop=loop, name=f"{name}/budget")
        self.scenario.drives[1].close()
        self.scenario.drives[1] = Drive(
            self.scenario.bus,
            variant.model,
            1,
            encoding=variant.encoding,
            options=dict(variant.drive_options),
            store=MemoryStore(),
            limits=DriveLimits(eeprom_writes_per_day=EEPROM_WRITES_PER_DAY),
        )
        self.saved: Counter[str] = Counter()
        """EEPROM writes of the drive, by the latest day that the clock has shown."""
        self.latest = ""

    def use_budget(self, jumps: list[str]) -> None:
        with installed_clock(self.clock):
            for name in jumps:
                self.clock.jump(name)
                self.campaign_run.count(f"budget after {name}")
                for _ in range(self.chance.randrange(1, EEPROM_WRITES_PER_DAY + 2)):
                    self._save()
            self.scenario.close()

    def _save(self) -> None:
        scenario, memory = self.scenario, self.scenario.station(1).memory
        if (self.clock.now().hour, self.clock.now().minute, self.clock.now().second >= 50) == (23, 59, True):
            scenario.run(11.0)  # past the midnight: the day of a save must be known
        self.latest = max(self.latest, self.clock.now().date().isoformat())
        before = memory.eeprom_writes.total()
        user_command = scenario.command(
            1,
            "write",
            {written_parameter(self.variant.model).notation: float(1 + scenario.oracle.command_count % 30)},
            save=True,
        )
        scenario.finish(user_command)
        written = memory.eeprom_writes.total() - before
        free = self.saved[self.latest] < EEPROM_WRITES_PER_DAY
        self.saved[self.latest] += written
        if written > free or free is (user_command.result_word == "EepromBudgetExceeded"):
            text = f"{self.saved[self.latest]} saves on {self.latest}, the last one ended as {user_command.result_word}"
            scenario.oracle.violation(f"EEPROM budget: {text}, the clock at {self.clock.now()}")


def run(campaign_run: CampaignRun) -> None:
    """Run trials of all variants in turn until the budget of jumps is spent."""
    for file, name in sorted(clock_readers(PACKAGE_FOLDER) - CLOCK_READER):
        campaign_run.violation(f"{file} reads the wall clock: {name}")
    number = 0
    with TemporaryDirectory() as folder:
        while campaign_run.remaining:
            variant = COVERED[number % len(COVERED)]
            rng = campaign_run.rng("jumps", number)
            jumps = [rng.choice(list(CLOCK_JUMPS_S)) for _ in range(min(JUMPS_PER_TRIAL, campaign_run.remaining))]
            campaign_run.counts.update(f"jump {name}" for name in jumps)
            compare_clocks(campaign_run, variant, number, jumps, Path(folder))
            EepromBudgetTrial(campaign_run, variant, f"{variant.name}/{number}", rng).use_budget(jumps)
            HostSleepScenario(campaign_run, variant, f"{variant.name}/{number}/night", rng).play()
            campaign_run.count("sleeps")
            number += 1
            campaign_run.add_trials(len(jumps))


CAMPAIGN = Campaign(
    name="clock",
    summary={"en": "Wall clocks that jump.", "zh": "跳变的系统时钟。"},
    unit="jumps",
    evidence_for=(
        "T13",
        "I1",
    ),
    full_budget=1000,
    ci_budget=60,
    run=run,
)
