"""The real rooms around the plant process, put together for one state directory."""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any

from drivebus.plant import operations as ask
from drivebus.plant.actor import Actor
from drivebus.plant.alarms import AlarmBook, Own
from drivebus.plant.alarms.log import AlarmLog
from drivebus.plant.audit import AuditTrail
from drivebus.plant.cases import CaseStore
from drivebus.plant.config.polling import profile_of
from drivebus.plant.historian import Historian
from drivebus.plant.interlocks import Interlocks
from drivebus.plant.keeping import Keeping
from drivebus.plant.model import PlantSetting
from drivebus.plant.parts import Handler, Parts
from drivebus.plant.runbook import RunBook
from drivebus.plant.state import Plant
from drivebus.plant.view import DriveView, Sample
from drivebus.profiles.model import Text

Json = dict[str, Any]


class Heard:
    """The history, with the flight recorder listening."""

    def __init__(self, history: Historian, keeping: Keeping) -> None:
        self._history, self._keeping = history, keeping

    @property
    def ok(self) -> bool:
        return self._history.ok

    @property
    def problem(self) -> str | None:
        return self._history.writer.problem

    def append(self, samples: Sequence[Sample]) -> None:
        self._history.append(samples)
        self._keeping.samples(samples)


class Rooms:
    """Audit trail, history and alarms on disk. ``open`` before the service starts, ``close`` after it has ended."""

    def __init__(self, setting: PlantSetting, now: Callable[[], float], wall_ms: Callable[[], int]) -> None:
        self.setting, self._now, self._wall_ms = setting, now, wall_ms
        self.trail = AuditTrail(setting.directory, setting.audit.checkpoints, setting.audit.key)
        self.history = Historian(setting.history, setting.directory, wall_ms=wall_ms)
        self.runs = RunBook(self.history)
        self.log = AlarmLog(setting.directory / "alarms.jsonl")
        self.keeping = Keeping(self.log, CaseStore(setting.directory / "cases"), now)
        self.keeping.stores[self.trail.places.current.name] = lambda: self.trail.error
        self.keeping.stores[self.trail.places.checkpoints.name] = lambda: self.trail.mark_error
        self.alarms: AlarmBook | None = None

    async def open(self) -> Parts:
        """Never fails for a disk: what can't be written is told by ``ok``."""
        await self.trail.open()
        await self.history.open()
        self.history.label(labels(self.setting))
        await self.runs.open()
        known = self.log.load()
        self.alarms = AlarmBook(
            self.setting.alarms, self.setting.drives, self.keeping, known,
            first=self.log.first, now=self._now(), now_ms=self._wall_ms(),
        )  # fmt: skip
        interlocks = Interlocks(self.setting.interlocks)
        return Parts(
            self.trail, Heard(self.history, self.keeping), self.alarms, interlocks, self.handlers(), self._event,
            self.disk, self.history.status, self.runs.of, self._view, self._plant, self._setting,
        )  # fmt: skip

    async def close(self) -> None:
        await self.keeping.close()
        await self.log.close()
        await self.runs.close()
        await self.history.close()
        await self.trail.close()

    def _plant(self, plant: Plant) -> None:
        self.keeping.bind(plant)
        if self.trail.cut:
            asyncio.get_running_loop().call_soon(partial(plant.alarm, Own.AUDIT, about="audit.jsonl"))

    def _view(self, view: DriveView, now: float, now_ms: int) -> None:
        self.keeping.view(view, now, now_ms)
        self.runs.on_view(view, now, now_ms)

    def _setting(self, setting: PlantSetting) -> None:
        gone = {drive.id for drive in self.setting.drives} - {drive.id for drive in setting.drives}
        self.setting = setting
        self.history.label(labels(setting))
        for drive in gone:
            self.keeping.forget(drive)

    def _event(self, event: Json) -> None:
        self.history.put_event(event)
        self.keeping.event(event)

    def handlers(self) -> Mapping[str, Handler]:
        """The operations that these rooms answer."""

        async def audit_list(params: ask.Span, actor: Actor) -> Json:
            return await self.trail.entries(params.from_ms, params.to_ms, params.drive, params.cursor, params.limit)

        async def audit_verify(params: ask.Nothing, actor: Actor) -> Json:
            return await self.trail.verify()

        return {
            "audit.list": audit_list,
            "audit.verify": audit_verify,
            **self.history.handlers(),
            **self.runs.handlers(),
            **self.keeping.handlers(),
        }

    def disk(self) -> Json:
        """Room on the disk of the state directory."""
        with suppress(OSError):
            found = shutil.disk_usage(self.setting.directory)
            return {"free_mb": found.free // 2**20, "total_mb": found.total // 2**20}
        return {}


def labels(setting: PlantSetting) -> dict[str, tuple[str, Text]]:
    """Unit and text of every tag that the plant's drives may have. Raises ProfileError."""
    profiles = {drive.id: profile_of(drive) for drive in setting.drives}
    return {
        f"{drive}.{name}": (signal.unit, signal.text)
        for drive, profile in profiles.items()
        for name, signal in profile.signals.items()
    }
