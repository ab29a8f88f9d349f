"""``clock``: the wall clock jumps by ±1 s, ±1 h, ±10 years and summer time, at random instants.

Each story is lived twice with the same seed, once under an honest wall clock and once under one that jumps. Every
byte on the wire with its time, every outcome, every reading with its time, and a capture but for its label must be
the same. Beside it the EEPROM budget is drawn upon under a clock that jumps around midnight, and a host falls
asleep with commands queued.
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
from verification.drive_variants import DRIVE_VARIANTS, DriveVariant
from verification.fault_injection.host_sleep import HostSleepScenario
from verification.fault_injection.wall_clock import (
    CLOCK_JUMPS_S,
    JumpingWallClock,
    before_midnight,
    clock_readers,
    installed_clock,
)
from verification.report import PACKAGE_FOLDER
from verification.scenario.scenario import Scenario

CLOCK_READER = {("clock.py", "datetime.now")}
"""The only reader of a wall clock."""
JUMPS_PER_STORY = 10
"""Jumps of one story."""
STORY_DURATION_S, MEAN_COMMAND_PAUSE_S = 20.0, 1.0
CLOCK_LINE_QUALITIES = ("clean", "clean", "bytes", "loss=0.05", "late=0.05:0.3", "noisy")
WRITABLE_PARAMETERS = {"c320": "F0.2", "dzb100": "10", "vc660": "F00.02", "df800": "F1.00"}
EEPROM_WRITES_PER_DAY = 3
ScriptedEvent = tuple[float, str, tuple[Any, ...]]


class ClockStory:
    """One story, lived once: ``jumps`` tells whether the clock does."""

    def __init__(
        self, session: CampaignRun, kind: DriveVariant, name: str, seed: int, capture: Path, jumps: bool
    ) -> None:
        self.lines: list[str] = []
        self.session = CampaignRun("clock", session.seed, 1, listener=self.lines.append)
        chance, self.jumps = Random(seed), jumps
        self.clock = JumpingWallClock(
            before_midnight(chance.uniform(0.0, 2 * STORY_DURATION_S)), (loop := VirtualLoop()).time
        )
        self.recorder: RecordingPort | None = None
        self.newest: Counter[tuple[int, str]] = Counter()

        def record(port: Any) -> RecordingPort:
            self.recorder = RecordingPort(port, capture)
            return self.recorder

        with installed_clock(self.clock):
            self.scenario = Scenario(self.session, kind, (1, 2), loop=loop, name=name, seed=seed, around=record)
            self.scenario.bench.line_quality = chance.choice(CLOCK_LINE_QUALITIES)
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
        """Samples come in order, and none from the future."""
        at = reading.source_time
        if not self.newest[address, name] < at <= self.scenario.loop.time():
            self.scenario.oracle.violation(
                f"G15 {name} of {address} at {at} s came after one at {self.newest[address, name]} s"
            )
        self.newest[address, name] = at
        self.scenario.oracle.trace(f"~ {address} {name} {reading.value} {at:.6f}")

    def play(self, events: list[ScriptedEvent]) -> None:
        with installed_clock(self.clock):
            for at, what, arguments in events:
                self.scenario.run(at - self.scenario.loop.time())
                if what != "jump":
                    self.scenario.command(arguments[0], what, *arguments[1:])
                elif self.jumps:
                    self.clock.jump(arguments[0])
            self.scenario.run(STORY_DURATION_S - self.scenario.loop.time())
            self.scenario.close()
        assert self.recorder is not None
        self.recorder.end_capture()


def random_script(kind: DriveVariant, chance: Random, jumps: list[str]) -> list[ScriptedEvent]:
    """What happens when: wishes, and the jumps at instants of their own."""
    events: list[ScriptedEvent] = [(chance.uniform(0.2, STORY_DURATION_S), "jump", (name,)) for name in jumps]
    at = chance.expovariate(1 / MEAN_COMMAND_PAUSE_S)
    while at < STORY_DURATION_S:
        address, hz = chance.choice((1, 2)), chance.choice((5.0, 12.0))
        value = {WRITABLE_PARAMETERS[kind.model]: float(chance.randrange(1, 40))}
        commands: tuple[tuple[str, tuple[Any, ...]], ...] = (
            ("run", (address, hz)),
            ("stop", (address,)),
            ("set_frequency", (address, hz)),
            ("write", (address, value, True)),
            ("reset_fault", (address,)),
        )
        events.append((at, *chance.choice(commands)))
        at += chance.expovariate(1 / MEAN_COMMAND_PAUSE_S)
    return sorted(events, key=lambda event: event[0])


def compare_clocks(session: CampaignRun, kind: DriveVariant, number: int, jumps: list[str], folder: Path) -> None:
    """The same story under both clocks."""
    chance = session.rng(kind.name, number)
    events, seed, name = random_script(kind, chance, jumps), chance.randrange(2**31), f"{kind.name}/{number}"
    lives = [
        ClockStory(session, kind, name, seed, folder / f"{number}-{jumping}", jumping) for jumping in (False, True)
    ]
    for life in lives:
        life.play(events)
        for text in life.session.violations:
            session.violation(text)
    honest, jumped = (life.lines for life in lives)
    for line in jumped:
        session.trace(line)
    differs = next((pair for pair in zip(honest, jumped, strict=False) if pair[0] != pair[1]), None)
    if differs is not None or len(honest) != len(jumped):
        session.violation(f"G15 {name}, seed {session.seed}: honest {differs and differs[0]}, jumped {differs}")
    records = [(folder / f"{number}-{jumping}").read_bytes().partition(b"\n")[2] for jumping in (False, True)]
    if records[0] != records[1] or not records[0]:
        session.violation(f"G15 {name}, seed {session.seed}: the captures differ")
    session.counts.update(lives[1].session.counts)
    session.count("samples", sum("~" in line for line in jumped))
    session.count("frames", lives[1].scenario.oracle.request_count)


class EepromBudgetTrial:
    """Saves under a clock that jumps: each day later than all before has its budget once."""

    def __init__(self, session: CampaignRun, kind: DriveVariant, name: str, chance: Random) -> None:
        self.session, self.kind, self.chance = session, kind, chance
        loop = VirtualLoop()
        self.clock = JumpingWallClock(before_midnight(chance.uniform(0.0, 30.0)), loop.time)
        self.scenario = Scenario(session, kind, (1,), loop=loop, name=f"{name}/budget")
        self.scenario.drives[1].close()
        self.scenario.drives[1] = Drive(
            self.scenario.bus,
            kind.model,
            1,
            encoding=kind.encoding,
            options=dict(kind.drive_options),
            store=MemoryStore(),
            limits=DriveLimits(eeprom_writes_per_day=EEPROM_WRITES_PER_DAY),
        )
        self.saved: Counter[str] = Counter()
        """Writes that the drive's EEPROM saw, by the latest day that was ever shown."""
        self.latest = ""

    def use_budget(self, jumps: list[str]) -> None:
        with installed_clock(self.clock):
            for name in jumps:
                self.clock.jump(name)
                self.session.count(f"budget after {name}")
                for _ in range(self.chance.randrange(1, EEPROM_WRITES_PER_DAY + 2)):
                    self._save()
            self.scenario.close()

    def _save(self) -> None:
        stand, memory = self.scenario, self.scenario.station(1).memory
        if (self.clock.now().hour, self.clock.now().minute, self.clock.now().second >= 50) == (23, 59, True):
            stand.run(11.0)  # past the midnight: the day of a save must be known
        self.latest = max(self.latest, self.clock.now().date().isoformat())
        before = memory.eeprom_writes.total()
        user_command = stand.command(
            1, "write", {WRITABLE_PARAMETERS[self.kind.model]: float(1 + stand.oracle.command_count % 30)}, True
        )
        stand.finish(user_command)
        written = memory.eeprom_writes.total() - before
        free = self.saved[self.latest] < EEPROM_WRITES_PER_DAY
        self.saved[self.latest] += written
        if written > free or free is (user_command.result_word == "EepromBudgetExceeded"):
            text = f"{self.saved[self.latest]} saves on {self.latest}, the last one ended as {user_command.result_word}"
            stand.oracle.violation(f"G16 {text}, the clock at {self.clock.now()}")


def run(session: CampaignRun) -> None:
    """Stories of all kinds in turn, until so many jumps are done."""
    for file, name in sorted(clock_readers(PACKAGE_FOLDER) - CLOCK_READER):
        session.violation(f"F21 {file} reads the wall clock: {name}")
    number = 0
    with TemporaryDirectory() as folder:
        while session.remaining:
            kind = DRIVE_VARIANTS[number % len(DRIVE_VARIANTS)]
            chance = session.rng("jumps", number)
            jumps = [chance.choice(list(CLOCK_JUMPS_S)) for _ in range(min(JUMPS_PER_STORY, session.remaining))]
            session.counts.update(f"jump {name}" for name in jumps)
            compare_clocks(session, kind, number, jumps, Path(folder))
            EepromBudgetTrial(session, kind, f"{kind.name}/{number}", chance).use_budget(jumps)
            HostSleepScenario(session, kind, f"{kind.name}/{number}/night", chance).play()
            session.count("sleeps")
            number += 1
            session.add_trials(len(jumps))


CAMPAIGN = Campaign(
    name="clock",
    summary={"en": "Clocks that jump.", "zh": "跳变的时钟。"},
    unit="jumps",
    evidence_for=(
        "T13",
        "I1",
    ),
    full_budget=1000,
    ci_budget=60,
    run=run,
)
