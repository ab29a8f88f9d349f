"""What tests of the plant share: a whole service over simulated buses in one process, in virtual or real time."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from drivebus.drives import MemoryStore
from drivebus.errors import AuditUnavailable
from drivebus.plant.access.rights import RIGHTS, Role
from drivebus.plant.actor import Actor, local
from drivebus.plant.alarms import Alarm, AlarmBook
from drivebus.plant.audit import Entry
from drivebus.plant.interlocks import Interlocks
from drivebus.plant.logs import LOG
from drivebus.plant.model import BusSetting, DriveSetting, GroupSetting, PlantSetting
from drivebus.plant.parts import Parts
from drivebus.plant.service import Service
from drivebus.plant.view import Sample
from drivebus.profiles.model import Text
from drivebus.sim.port import SimPort, forget_benches

Json = dict[str, Any]
LOCAL = local("tester", "local-1")


def remote(name: str = "ann", role: Role = Role.OPERATOR, session: str | None = None) -> Actor:
    """Somebody at a browser."""
    return Actor(name, RIGHTS[role], session or f"session-{name}", remote=True, address="127.0.0.1")


BUSES = (
    BusSetting("a", "sim://c320@1,2?ramp=2"),
    BusSetting("b", "sim://vc660@1,2?ramp=2"),
)
DRIVES = (
    DriveSetting("fan-1", "a", 1, "c320", Text("Fan 1", "风机 1")),
    DriveSetting("fan-2", "a", 2, "c320", Text("Fan 2", "风机 2")),
    DriveSetting("pump-1", "b", 1, "vc660", Text("Pump 1", "水泵 1")),
    DriveSetting("pump-2", "b", 2, "vc660", Text("Pump 2", "水泵 2")),
)
GROUPS = (GroupSetting("fans", ("fan-1", "fan-2"), Text("Fans", "风机")),)

FAN_FILE = """
format = 1
[plant]
id = "p"
[bus.a]
link = "tcp://127.0.0.1:1?baud=9600&format=8E1"
[drive.fan]
bus = "a"
address = 1
model = "c320"
"""
"""The beginning of a plant.toml: one drive, whose table is still open."""

SHOP_FILE = """
format = 1

[plant]
id = "shop"
directory = "state"

[bus.a]
link = "sim://c320@1"

[drive.fan-1]
bus = "a"
address = 1
model = "c320"
"""
"""A whole plant.toml: one simulated drive."""


def setting(**changed: Any) -> PlantSetting:
    """Two lines with two drives each, unless told otherwise."""
    given: Json = {"buses": BUSES, "drives": DRIVES, "groups": GROUPS, "directory": Path("/nonexistent")}
    return PlantSetting(id="test", title=Text("Test", "测试"), **(given | changed))


@dataclass
class PaperTrail:
    """An audit trail in memory; ``broken`` makes it one that can't be written, ``takes_s`` one that is slow."""

    entries: list[Entry] = field(default_factory=list)
    broken: bool = False
    unseen: bool = False
    """It can't be written and nobody knows yet: ``ok`` tells of the last attempt."""
    takes_s: float = 0.0

    @property
    def ok(self) -> bool:
        return not self.broken

    async def record(self, entry: Entry) -> int:
        if self.takes_s:
            await asyncio.sleep(self.takes_s)
        if self.broken or self.unseen:
            raise AuditUnavailable("plant.audit_unavailable")
        self.entries.append(entry)
        return len(self.entries)

    def note(self, entry: Entry) -> None:
        self.entries.append(entry)

    def outcomes(self, what: str) -> list[str | None]:
        """What was recorded of an operation, in order."""
        return [entry.outcome for entry in self.entries if entry.what == what]


@dataclass
class PaperHistory:
    """Samples in memory."""

    samples: list[Sample] = field(default_factory=list)
    problem: str | None = None

    @property
    def ok(self) -> bool:
        return self.problem is None

    def append(self, samples: Sequence[Sample]) -> None:
        self.samples.extend(samples)


@dataclass
class PaperLog:
    alarms: list[Alarm] = field(default_factory=list)

    def put(self, alarm: Alarm) -> None:
        self.alarms.append(alarm)


@dataclass
class Kit:
    """A running plant and what is around it. ``service`` is a ``PlantClient``."""

    service: Service
    trail: PaperTrail
    history: PaperHistory
    store: MemoryStore

    async def call(self, operation: str, actor: Actor = LOCAL, **params: Any) -> Json:
        return await self.service.call(operation, params, actor)

    def station(self, drive: str) -> Any:
        """The simulated drive itself."""
        unit = self.service.plant.units[drive]
        port: Any = unit.bus.port
        assert isinstance(port, SimPort)
        return port.bench.station(unit.setting.address)

    async def waive(self, *drives: str) -> None:
        """Let these start although nobody knows what they do when the host dies."""
        for drive in drives or tuple(self.service.plant.units):
            await self.call("drive.waiver", drive=drive, reason="test bench")


def parts_of(chosen: PlantSetting, trail: Any, history: Any, **more: Any) -> Parts:
    """Real alarms and interlocks around paper."""
    alarms = AlarmBook(chosen.alarms, chosen.drives, PaperLog())
    return Parts(trail, history, alarms, Interlocks(chosen.interlocks), **more)


@asynccontextmanager
async def plant(chosen: PlantSetting | None = None, *, store: MemoryStore | None = None) -> AsyncIterator[Kit]:
    """A service over simulated drives. Run it with ``drivebus.testing.virtual.run``, or in real time."""
    chosen = chosen or setting()
    trail, history, kept = PaperTrail(), PaperHistory(), store or MemoryStore()
    service = Service(chosen, parts_of(chosen, trail, history), store=kept, drive_store=MemoryStore())
    failures: list[logging.LogRecord] = []
    LOG.addFilter(noted := lambda record: not record.exc_info or failures.append(record) or True)
    try:
        async with service:
            yield Kit(service, trail, history, kept)
    finally:
        LOG.removeFilter(noted)
        forget_benches()
    assert not failures, failures
