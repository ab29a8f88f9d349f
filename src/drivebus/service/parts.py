"""What the plant process expects of the rooms around it; ``assemble`` puts the real ones in."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from drivebus.service.alarms import AlarmEngine
from drivebus.service.audit import AuditEntry
from drivebus.service.auth.actor import Actor
from drivebus.service.config.model import PlantConfig
from drivebus.service.interlocks.engine import InterlockEngine
from drivebus.service.live.views import DriveView, Sample

Json = dict[str, Any]
OperationHandler = Callable[[Any, Actor], Awaitable[Json]]
"""Takes checked parameters and the actor."""


class AuditTrailLike(Protocol):
    """The audit trail: ``audit.AuditTrail``."""

    @property
    def ok(self) -> bool:
        """Could the last entry be written?"""
        ...

    async def record(self, entry: AuditEntry) -> int:
        """Its number; durable on return. Raises AuditUnavailable."""
        ...

    def record_nowait(self, entry: AuditEntry) -> None:
        """Written soon, or once the disk works again."""
        ...


class SampleSink(Protocol):
    """Where samples go. Nothing here waits for a disk."""

    @property
    def ok(self) -> bool: ...
    @property
    def problem(self) -> str | None:
        """Why it can't be written, in the store's words."""
        ...

    def append(self, samples: Sequence[Sample]) -> None: ...


@dataclass
class ServiceParts:
    """The rooms around the plant process. ``handlers`` are the operations that they answer themselves."""

    trail: AuditTrailLike
    history: SampleSink
    alarms: AlarmEngine
    interlocks: InterlockEngine
    handlers: Mapping[str, OperationHandler] = field(default_factory=dict)
    on_event: Callable[[Json], None] = lambda event: None
    """Every event, for the history's markers."""
    disk: Callable[[], Json] = dict
    """Room on the disk of the state directory."""
    history_status: Callable[[], Json] = dict
    """``Historian.status``."""
    run_statistics: Callable[[str], Json] = lambda drive: {}
    """What a drive has done so far: ``RunStatisticsStore.of``."""
    on_view: Callable[[DriveView, float, int], None] = lambda view, now, now_ms: None
    """Every look at a drive, for run statistics and cases."""
    on_plant: Callable[[Any], None] = lambda plant: None
    """The ``state.Plant`` that all this is around, before it starts."""
    on_config: Callable[[PlantConfig], None] = lambda setting: None
    """Other settings, taken over while it runs."""
