"""``clock`` (G15, F21): the wall clock jumps by ±1 s, ±1 h, ±10 years and summer time, at random instants.

Each story is lived twice with the same seed, once under an honest wall clock and once under one that jumps. Every
byte on the wire with its time, every outcome, every reading with its time, and a capture but for its label must be
the same. Beside it the EEPROM budget is drawn upon under a clock that jumps around midnight (G16), and a host falls
asleep with commands queued (6.6).
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Any

from drivebus.drives import Drive, DriveLimits, MemoryStore
from drivebus.drives.state import DriveStatus
from drivebus.lab.breaking.asleep import Night
from drivebus.lab.breaking.wallclock import JUMPS_S, WallClock, before_midnight, installed, readers
from drivebus.lab.campaign import Campaign, Session
from drivebus.lab.kinds import KINDS, Kind
from drivebus.lab.report import PACKAGE
from drivebus.lab.world.loop import Loop
from drivebus.lab.world.stand import Stand
from drivebus.ports.capturing import CapturingPort

DOOR = {("seams.py", "datetime.now")}
"""The only reader of a wall clock."""
EACH = 10
"""Jumps of one story."""
STORY_S, PAUSE_S = 20.0, 1.0
WEATHERS = ("clean", "clean", "bytes", "loss=0.05", "late=0.05:0.3", "noisy")
WRITTEN = {"c320": "F0.2", "dzb100": "10", "vc660": "F00.02", "df800": "F1.00"}
SAVES_A_DAY = 3
Event = tuple[float, str, tuple[Any, ...]]


class Life:
    """One story, lived once: ``jumps`` tells whether the clock does."""

    def __init__(self, session: Session, kind: Kind, name: str, seed: int, capture: Path, jumps: bool) -> None:
        self.lines: list[str] = []
        self.session = Session("clock", session.seed, 1, listener=self.lines.append)
        chance, self.jumps = Random(seed), jumps
        self.clock = WallClock(before_midnight(chance.uniform(0.0, 2 * STORY_S)), (loop := Loop()).time)
        self.recorder: CapturingPort | None = None
        self.newest: Counter[tuple[int, str]] = Counter()

        def record(port: Any) -> CapturingPort:
            self.recorder = CapturingPort(port, capture)
            return self.recorder

        with installed(self.clock):
            self.stand = Stand(self.session, kind, (1, 2), loop=loop, name=name, seed=seed, around=record)
            self.stand.bench.weather = chance.choice(WEATHERS)
            for address in self.stand.drives:
                self._watch(address)

    def _watch(self, address: int) -> None:
        def sampled(status: DriveStatus) -> None:
            for name, reading in status.readings.items():
                if reading.source_time is not None and reading.source_time != self.newest[address, name]:
                    self._sample(address, name, reading)

        monitor = self.stand.monitor(address)
        monitor._on_change = sampled

    def _sample(self, address: int, name: str, reading: Any) -> None:
        """Samples come in order, and none from the future."""
        at = reading.source_time
        if not self.newest[address, name] < at <= self.stand.loop.time():
            self.stand.witness.violation(
                f"G15 {name} of {address} at {at} s came after one at {self.newest[address, name]} s"
            )
        self.newest[address, name] = at
        self.stand.witness.note(f"~ {address} {name} {reading.value} {at:.6f}")

    def live(self, events: list[Event]) -> None:
        with installed(self.clock):
            for at, what, arguments in events:
                self.stand.run(at - self.stand.loop.time())
                if what != "jump":
                    self.stand.wish(arguments[0], what, *arguments[1:])
                elif self.jumps:
                    self.clock.jump(arguments[0])
            self.stand.run(STORY_S - self.stand.loop.time())
            self.stand.close()
        assert self.recorder is not None
        self.recorder.end_capture()


def script(kind: Kind, chance: Random, jumps: list[str]) -> list[Event]:
    """What happens when: wishes, and the jumps at instants of their own."""
    events: list[Event] = [(chance.uniform(0.2, STORY_S), "jump", (name,)) for name in jumps]
    at = chance.expovariate(1 / PAUSE_S)
    while at < STORY_S:
        address, hz = chance.choice((1, 2)), chance.choice((5.0, 12.0))
        value = {WRITTEN[kind.model]: float(chance.randrange(1, 40))}
        wishes: tuple[tuple[str, tuple[Any, ...]], ...] = (
            ("run", (address, hz)), ("stop", (address,)), ("set_frequency", (address, hz)),
            ("write", (address, value, True)), ("reset_fault", (address,)),
        )  # fmt: skip
        events.append((at, *chance.choice(wishes)))
        at += chance.expovariate(1 / PAUSE_S)
    return sorted(events, key=lambda event: event[0])


def twice(session: Session, kind: Kind, number: int, jumps: list[str], folder: Path) -> None:
    """The same story under both clocks."""
    chance = session.rng(kind.name, number)
    events, seed, name = script(kind, chance, jumps), chance.randrange(2**31), f"{kind.name}/{number}"
    lives = [Life(session, kind, name, seed, folder / f"{number}-{jumping}", jumping) for jumping in (False, True)]
    for life in lives:
        life.live(events)
        for text in life.session.violations:
            session.violation(text)
    honest, jumped = (life.lines for life in lives)
    for line in jumped:
        session.line(line)
    differs = next((pair for pair in zip(honest, jumped, strict=False) if pair[0] != pair[1]), None)
    if differs is not None or len(honest) != len(jumped):
        session.violation(f"G15 {name}, seed {session.seed}: honest {differs and differs[0]}, jumped {differs}")
    records = [(folder / f"{number}-{jumping}").read_bytes().partition(b"\n")[2] for jumping in (False, True)]
    if records[0] != records[1] or not records[0]:
        session.violation(f"G15 {name}, seed {session.seed}: the captures differ")
    session.counts.update(lives[1].session.counts)
    session.count("samples", sum("~" in line for line in jumped))
    session.count("frames", lives[1].stand.witness.frames)


class Budget:
    """Saves under a clock that jumps: each day later than all before has its budget once (G16)."""

    def __init__(self, session: Session, kind: Kind, name: str, chance: Random) -> None:
        self.session, self.kind, self.chance = session, kind, chance
        loop = Loop()
        self.clock = WallClock(before_midnight(chance.uniform(0.0, 30.0)), loop.time)
        self.stand = Stand(session, kind, (1,), loop=loop, name=f"{name}/budget")
        self.stand.drives[1].close()
        self.stand.drives[1] = Drive(
            self.stand.bus, kind.model, 1, encoding=kind.encoding, settings=dict(kind.settings), store=MemoryStore(),
            limits=DriveLimits(saves_per_day=SAVES_A_DAY),
        )  # fmt: skip
        self.saved: Counter[str] = Counter()
        """Writes that the drive's EEPROM saw, by the latest day that was ever shown."""
        self.latest = ""

    def draw(self, jumps: list[str]) -> None:
        with installed(self.clock):
            for name in jumps:
                self.clock.jump(name)
                self.session.count(f"budget after {name}")
                for _ in range(self.chance.randrange(1, SAVES_A_DAY + 2)):
                    self._save()
            self.stand.close()

    def _save(self) -> None:
        stand, memory = self.stand, self.stand.station(1).memory
        if (self.clock.now().hour, self.clock.now().minute, self.clock.now().second >= 50) == (23, 59, True):
            stand.run(11.0)  # past the midnight: the day of a save must be known
        self.latest = max(self.latest, self.clock.now().date().isoformat())
        before = memory.eeprom_writes.total()
        wish = stand.wish(1, "write", {WRITTEN[self.kind.model]: float(1 + stand.witness.made % 30)}, True)
        stand.finish(wish)
        written = memory.eeprom_writes.total() - before
        free = self.saved[self.latest] < SAVES_A_DAY
        self.saved[self.latest] += written
        if written > free or free is (wish.word == "WearBudget"):
            said = f"{self.saved[self.latest]} saves on {self.latest}, the last one ended as {wish.word}"
            stand.witness.violation(f"G16 {said}, the clock at {self.clock.now()}")


def run(session: Session) -> None:
    """Stories of all kinds in turn, until so many jumps are done."""
    for file, name in sorted(readers(PACKAGE) - DOOR):
        session.violation(f"F21 {file} reads the wall clock: {name}")
    number = 0
    with TemporaryDirectory() as folder:
        while session.left:
            kind = KINDS[number % len(KINDS)]
            chance = session.rng("jumps", number)
            jumps = [chance.choice(list(JUMPS_S)) for _ in range(min(EACH, session.left))]
            session.counts.update(f"jump {name}" for name in jumps)
            twice(session, kind, number, jumps, Path(folder))
            Budget(session, kind, f"{kind.name}/{number}", chance).draw(jumps)
            Night(session, kind, f"{kind.name}/{number}/night", chance).play()
            session.count("sleeps")
            number += 1
            session.did(len(jumps))


CAMPAIGN = Campaign("clock", "jumps", ("G15", "G16", "F21", "T13", "I1"), 1000, 60, run)
