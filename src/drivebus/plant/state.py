"""What the rooms of the plant process share: its lines and drives, who owns them, the hub, and the parts around."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, TypeVar

from drivebus.drives.memory import DriveLimits
from drivebus.drives.state import Outcome, OutcomeWord
from drivebus.errors import NotFound
from drivebus.plant.alarms import Change, Own
from drivebus.plant.failure import both
from drivebus.plant.hub import Hub
from drivebus.plant.leases import Arms, Leases
from drivebus.plant.lines import Line
from drivebus.plant.logs import happened
from drivebus.plant.model import AlarmKind, GroupSetting, PlantSetting
from drivebus.plant.parts import Parts
from drivebus.plant.units import Unit
from drivebus.plant.waivers import Waiver
from drivebus.seams import Store

Json = dict[str, Any]
TOLD = frozenset({str(AlarmKind.SILENT), str(AlarmKind.FAULT), str(Own.PORT)})
"""Alarms of what has a line of its own in the log when it begins and ends."""


@dataclass(slots=True)
class Stops:
    """Stops of single drives since the service began; a stop of everything is one of each drive."""

    asked: int = 0
    confirmed: int = 0
    """The drive was read to stand."""
    acknowledged: int = 0
    """The drive said yes, and can't be read."""

    def ended(self, outcome: Outcome) -> None:
        self.confirmed += outcome.word is OutcomeWord.CONFIRMED
        self.acknowledged += outcome.word is OutcomeWord.ACKNOWLEDGED

    def as_json(self) -> Json:
        return asdict(self)


@dataclass
class Plant:
    """The plant as it is now. ``now`` is monotonic (S20); ``wall_ms`` is for labels only."""

    setting: PlantSetting
    now: Callable[[], float]
    wall_ms: Callable[[], int]
    hub: Hub
    parts: Parts
    store: Store
    """Waivers and limits, which outlive the process."""
    lines: dict[str, Line] = field(default_factory=dict)
    units: dict[str, Unit] = field(default_factory=dict)
    leases: Leases = field(default_factory=Leases)
    arms: Arms = field(default_factory=Arms)
    stops: Counter[str] = field(default_factory=Counter)
    """How often somebody wished each drive to stop, by name: a start that was wished before is void. No reload takes
    anything from it."""
    state: str = "running"
    started_ms: int = 0
    last_stop: Json | None = None
    disk: Json = field(default_factory=dict)
    """Free space of the state directory."""
    commands: int = 0
    """Commands so far: what their ids are made of."""
    events: int = 0
    tally: Stops = field(default_factory=Stops)

    def unit(self, id: str) -> Unit:
        """Raises NotFound."""
        return _found(self.units, "drive", id)

    def line(self, id: str) -> Line:
        """Raises NotFound."""
        return _found(self.lines, "bus", id)

    def group(self, id: str) -> GroupSetting:
        """Raises NotFound."""
        return _found({group.id: group for group in self.setting.groups}, "group", id)

    def line_of(self, unit: Unit) -> Line:
        return self.lines[unit.setting.bus]

    def groups_of(self, id: str) -> list[GroupSetting]:
        return [group for group in self.setting.groups if id in group.drives]

    def followers(self, leader: str) -> list[tuple[GroupSetting, Unit]]:
        """Who gets its share when this drive gets another frequency: drives of its group that this service started."""
        found = [(group, id) for group in self.groups_of(leader) if group.leader == leader for id in group.drives]
        return [(group, self.unit(id)) for group, id in found if id != leader and self.unit(id).started]

    def command_id(self, word: str) -> str:
        """A name for a command that nobody else has in this life of the service."""
        self.commands += 1
        return f"{word}-{self.commands}"

    def tell(
        self,
        kind: str,
        drive: str | None,
        key: str,
        /,
        *,
        actor: str | None = None,
        outcome: str | None = None,
        **params: Any,
    ) -> None:
        """Something happened: everybody who listens is told, and the history keeps a marker."""
        self.event(kind, drive, both(key, params), actor, outcome)

    def event(
        self, kind: str, drive: str | None, text: Json, actor: str | None, outcome: str | None, *, log: bool = True
    ) -> None:
        """The same with its text ready."""
        self.events += 1
        event = {
            "id": f"{self.started_ms}-{self.events}", "time_ms": self.wall_ms(), "kind": kind, "drive": drive,
            "text": text, "actor": actor, "outcome": outcome,
        }  # fmt: skip
        self.hub.append("events", event)
        self.parts.on_event(event)
        if log:
            happened(event)

    def alarm(self, kind: Own, drive: str = "", *, about: str = "", **params: Any) -> None:
        """Raise an alarm of the plant's own."""
        self.alarmed(self.parts.alarms.raise_alarm(kind, drive, self.wall_ms(), about=about, **params))

    def calm(self, kind: Own, drive: str = "", *, about: str = "") -> None:
        """What raised it is over."""
        self.alarmed(self.parts.alarms.clear_alarm(kind, drive, self.wall_ms(), about=about))

    def alarmed(self, changes: Sequence[Change]) -> None:
        """Tell everybody what happened to some alarms; that one has its case now is seen in the alarm itself."""
        for word, alarm in ((change.word, change.alarm) for change in changes if change.word != "case"):
            text = both(f"plant.alarm_{word}", {"text": alarm.text})
            actor = alarm.by if word == "acknowledged" else None
            self.event("alarm", alarm.drive or None, text, actor, word, log=alarm.kind not in TOLD)

    def stopped(self, *units: Unit) -> None:
        """Somebody stops these: what was armed for them, or for a group that they are in, starts nothing any more."""
        for unit in units:
            self.arms.void(unit.id, *(f"group:{group.id}" for group in self.groups_of(unit.id)))
            self.stops[unit.id] += 1
            self.tally.asked += 1

    # --- what outlives the process ------------------------------------------------------------------------------

    def recall(self, unit: Unit) -> None:
        """Its waiver, and limits that are narrower than the file's, as recorded before."""
        self._recall_waiver(unit)
        limits = self.store.get(f"limits/{unit.id}")
        found = json.loads(limits) if limits else None
        unit.limit(None if found is None else narrower(DriveLimits(**found), unit.setting.limits))

    def _recall_waiver(self, unit: Unit) -> None:
        """One that was recorded for another drive of this name is left where it is, and said."""
        waiver = Waiver.kept(self.store.get(f"waiver/{unit.id}"))
        fits = waiver is not None and waiver.fits(unit.setting, self.line_of(unit).setting)
        unit.waiver = waiver.text if waiver is not None and fits else None
        unit.waiver_of_another = None if fits else waiver
        if unit.waiver_of_another is not None:
            self.tell("waiver", unit.id, "plant.waiver_ignored", **unit.waiver_of_another.whose)


def narrower(own: DriveLimits, file: DriveLimits) -> DriveLimits:
    """Both together: limits recorded by an engineer never reach beyond those of the plant's file."""
    highest = [value for value in (own.maximum_hz, file.maximum_hz) if value is not None]
    return DriveLimits(
        max(own.minimum_hz, file.minimum_hz), min(highest, default=None),
        own.forward and file.forward, own.reverse and file.reverse, file.saves_per_day,
    )  # fmt: skip


T = TypeVar("T")


def _found(known: dict[str, T], what: str, id: str) -> T:
    if id not in known:
        raise NotFound(f"plant.no_{what}", id=id)
    return known[id]
