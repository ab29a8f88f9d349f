"""What the plant process expects of the rooms around it; ``assemble`` puts the real ones in."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from drivebus.plant.actor import Actor
from drivebus.plant.alarms import AlarmBook
from drivebus.plant.audit import Entry
from drivebus.plant.interlocks import Interlocks
from drivebus.plant.model import PlantSetting
from drivebus.plant.view import DriveView, Sample

Json = dict[str, Any]
Handler = Callable[[Any, Actor], Awaitable[Json]]
"""Takes checked parameters and the actor."""


class Trail(Protocol):
    """The audit trail: ``audit.AuditTrail``."""

    @property
    def ok(self) -> bool:
        """Could the last entry be written?"""
        ...

    async def record(self, entry: Entry) -> int:
        """Its number; durable on return. Raises AuditUnavailable."""
        ...

    def note(self, entry: Entry) -> None:
        """Written soon, or once the disk works again."""
        ...


class History(Protocol):
    """Where samples go. Nothing here waits for a disk."""

    @property
    def ok(self) -> bool: ...
    @property
    def problem(self) -> str | None:
        """Why it can't be written, in the store's words."""
        ...

    def append(self, samples: Sequence[Sample]) -> None: ...


@dataclass
class Parts:
    """The rooms around the plant process. ``handlers`` are the operations that they answer themselves."""

    trail: Trail
    history: History
    alarms: AlarmBook
    interlocks: Interlocks
    handlers: Mapping[str, Handler] = field(default_factory=dict)
    on_event: Callable[[Json], None] = lambda event: None
    """Every event, for the history's markers."""
    disk: Callable[[], Json] = dict
    """Room on the disk of the state directory."""
    history_status: Callable[[], Json] = dict
    """``Historian.status``."""
    run_statistics: Callable[[str], Json] = lambda drive: {}
    """What a drive has done so far: ``RunBook.of``."""
    on_view: Callable[[DriveView, float, int], None] = lambda view, now, now_ms: None
    """Every look at a drive, for run statistics and cases."""
    on_plant: Callable[[Any], None] = lambda plant: None
    """The ``state.Plant`` that all this is around, before it starts."""
    on_setting: Callable[[PlantSetting], None] = lambda setting: None
    """Other settings, taken over while it runs."""
