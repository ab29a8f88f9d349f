"""The real rooms around the plant process, put together for one state directory."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

from drivebus.plant import operations as ask
from drivebus.plant.actor import Actor
from drivebus.plant.alarms import AlarmBook
from drivebus.plant.alarms.log import AlarmLog
from drivebus.plant.audit import AuditTrail
from drivebus.plant.historian import Historian
from drivebus.plant.interlocks import Interlocks
from drivebus.plant.logs import happened
from drivebus.plant.model import PlantSetting
from drivebus.plant.parts import Handler, Parts

Json = dict[str, Any]


class Rooms:
    """Audit trail, history and alarms on disk. ``open`` before the service starts, ``close`` after it has ended."""

    def __init__(self, setting: PlantSetting, now: Callable[[], float], wall_ms: Callable[[], int]) -> None:
        self.setting, self._now, self._wall_ms = setting, now, wall_ms
        self.trail = AuditTrail(setting.directory)
        self.history = Historian(setting.history, setting.directory, wall_ms=wall_ms)
        self.log = AlarmLog(setting.directory / "alarms.jsonl")
        self.alarms: AlarmBook | None = None

    async def open(self) -> Parts:
        """Never fails for a disk: what can't be written is told by ``ok``."""
        await self.trail.open()
        await self.history.open()
        known = self.log.load()
        self.alarms = AlarmBook(
            self.setting.alarms, self.setting.drives, self.log, known,
            first=self.log.first, now=self._now(), now_ms=self._wall_ms(),
        )  # fmt: skip
        interlocks = Interlocks(self.setting.interlocks)
        return Parts(self.trail, self.history, self.alarms, interlocks, self.handlers(), self._event, self.disk)

    async def close(self) -> None:
        await self.log.close()
        await self.history.close()
        await self.trail.close()

    def _event(self, event: Json) -> None:
        self.history.put_event(event)
        happened(event)

    def handlers(self) -> Mapping[str, Handler]:
        """The operations that these rooms answer."""

        async def audit_list(params: ask.Span, actor: Actor) -> Json:
            return await self.trail.entries(params.from_ms, params.to_ms, params.drive, params.cursor, params.limit)

        async def audit_verify(params: ask.Nothing, actor: Actor) -> Json:
            return await self.trail.verify()

        return {"audit.list": audit_list, "audit.verify": audit_verify, **self.history.handlers()}

    def disk(self) -> Json:
        """Room on the disk of the state directory."""
        with suppress(OSError):
            found = shutil.disk_usage(self.setting.directory)
            return {"free_mb": found.free // 2**20, "total_mb": found.total // 2**20}
        return {}
