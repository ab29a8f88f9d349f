"""Every drive's run statistics, kept through the historian."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from typing import Any, Protocol

from drivebus.errors import ServiceUnavailable
from drivebus.service.api.operations import DriveParams
from drivebus.service.live.views import DriveView
from drivebus.service.runtime.run_statistics import RunStatistics

Json = dict[str, Any]

DOCUMENT_KIND = "statistics"
SAVE_INTERVAL_S = 60.0
"""So often they are written; a killed service forgets so much."""
LOAD_RETRY_S = 10.0
LOAD_TIMEOUT_S = 1.0


class DocumentStore(Protocol):
    """What the historian does for it."""

    def put_document(self, kind: str, id: str, value: Any) -> None: ...
    async def documents(self, kind: str) -> dict[str, Any]: ...


class RunStatisticsStore:
    """Statistics of all drives."""

    def __init__(self, keeper: DocumentStore) -> None:
        self._documents = keeper
        self._drives: dict[str, RunStatistics] = {}
        self._saved_at: dict[str, float] = {}
        self._task: asyncio.Task[None] | None = None
        self.is_loaded = False

    async def open(self) -> None:
        """Begin with what was kept before; a database that does not answer now is asked again."""
        self._task = asyncio.create_task(self._load(), name="run statistics")
        await asyncio.wait({self._task}, timeout=LOAD_TIMEOUT_S)

    async def close(self) -> None:
        """Keep everything; the historian closes after this."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)
        for drive in self._drives:
            self._save(drive)

    async def _load(self) -> None:
        while not self.is_loaded:
            try:
                kept = await self._documents.documents(DOCUMENT_KIND)
            except ServiceUnavailable:
                await asyncio.sleep(LOAD_RETRY_S)
                continue
            self._drives = {drive: RunStatistics.from_document(document) for drive, document in kept.items()}
            self.is_loaded = True

    def on_view(self, view: DriveView, now: float, now_ms: int) -> None:
        """Look at one drive. Nothing is counted, and nothing written over, before the old numbers are known."""
        if not self.is_loaded:
            return
        statistics = self._drives.setdefault(view.id, RunStatistics())
        statistics.observe(view, now, now_ms)
        if now - self._saved_at.setdefault(view.id, now) >= SAVE_INTERVAL_S:
            self._save(view.id)
            self._saved_at[view.id] = now

    def _save(self, drive: str) -> None:
        self._documents.put_document(DOCUMENT_KIND, drive, self._drives[drive].to_document())

    def statistics_json(self, drive: str) -> Json:
        return self._drives.get(drive, RunStatistics()).as_json()

    def handlers(self) -> Mapping[str, Callable[[Any, Any], Awaitable[Json]]]:
        """The operation ``drives.statistics``; that the drive exists is checked before."""

        async def statistics(params: DriveParams, _actor: Any) -> Json:
            return self.statistics_json(params.drive)

        return {"drives.statistics": statistics}
