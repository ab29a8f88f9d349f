"""The audit trail as the service uses it: ``record`` returns when the record would survive a power cut.

A disk that fails refuses what waits for it (``AuditUnavailable``: no start without its record, G14) and delays what
does not: a stop goes first and is noted afterwards, if need be when the disk works again.
"""

from __future__ import annotations

import asyncio
import json
import sys
from asyncio.subprocess import PIPE
from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path

from drivebus import clock
from drivebus.errors import AuditUnavailable
from drivebus.service.audit.chain import MAX_AUDIT_FILE_BYTES, RECORDS_MISSING, AuditChain, AuditPaths
from drivebus.service.audit.query import query_records
from drivebus.service.audit.records import AuditEntry, entry_json
from drivebus.service.live.views import Json
from drivebus.service.storage.batch_writer import BatchWriter

CHECKPOINT_INTERVAL_S = 60.0
"""S12."""
AUDIT_RETRY_INTERVAL_S = 5.0
"""A disk that failed is tried again so often, also while nobody wants to start anything."""


class AuditTrail:
    """The trail in ``folder``. ``checkpoints`` and ``key`` may lie on another disk: ``audit.files.Places``."""

    def __init__(
        self,
        folder: Path,
        checkpoints: Path | None = None,
        key: Path | None = None,
        *,
        wall: Callable[[], datetime] = clock.wall_clock,
        full_at: int = MAX_AUDIT_FILE_BYTES,
    ) -> None:
        self.paths = AuditPaths.of(folder, checkpoints, key)
        self._wall_clock = wall
        self._chain = AuditChain(self.paths, self._now_ms, full_at)
        self._writer: BatchWriter[Json, int] = BatchWriter("audit", self._append_batch)
        self._timer: asyncio.Task[None] | None = None
        self._reported_losses = 0
        self.records_missing = False
        """When it was opened, records were missing that a checkpoint vouches for: somebody cut them off."""
        self.checkpoint_error: OSError | None = None
        """Why the last checkpoint was not written; starts are not refused for it."""

    @property
    def ok(self) -> bool:
        """Can it be written, as far as the last attempt told?"""
        return self._writer.error is None

    @property
    def error(self) -> Exception | None:
        """Why not."""
        return self._writer.error

    async def open(self) -> None:
        """Make ready, and begin to write checkpoints, the first one for what an earlier life left. Never fails: ``ok``
        tells, and it is tried again."""
        self._timer = asyncio.get_running_loop().create_task(self._write_checkpoints(), name="audit checkpoints")
        try:
            await self.record(AuditEntry("audit.opened"))
        except AuditUnavailable:
            self.record_nowait(AuditEntry("audit.opened"))
            return
        await self.checkpoint()

    async def record(self, entry: AuditEntry) -> int:
        """Its number; it is durable when this returns. Raises AuditUnavailable: what then becomes of the wish is to be
        noted, so that the disk is tried again."""
        return await self._writer.write(entry_json(entry, self._now_ms()))

    async def record_json(self, entry: Json) -> int:
        """``record`` of what is already JSON. Raises AuditUnavailable."""
        return await self.record(AuditEntry.from_json(entry))

    def record_nowait(self, entry: AuditEntry) -> None:
        """Written soon, or once the disk works again; waits for nothing and never fails (stops)."""
        self._writer.write_nowait(entry_json(entry, self._now_ms()))

    async def query(
        self, from_ms: int, to_ms: int, drive: str | None = None, cursor: str | None = None, limit: int = 100
    ) -> Json:
        """``{"items", "next"}``, the newest first. Raises InvalidParameters for a cursor of somebody else's."""
        return await self._in_thread(lambda: query_records(self.paths, from_ms, to_ms, drive, cursor, limit))

    async def verify(self) -> Json:
        """``audit.verify``: what the files say about themselves now. Raises AuditUnavailable where they can't be read.

        Another process reads them, so that a long trail delays no bus.
        """
        places = (self.paths.folder, self.paths.checkpoints, self.paths.key)
        command = (sys.executable, "-m", "drivebus.service.audit", *map(str, places))
        child = await asyncio.create_subprocess_exec(*command, stdout=PIPE, stderr=PIPE)
        try:
            told, failed = await child.communicate()
        finally:
            if child.returncode is None:
                child.kill()
        if child.returncode != 0:
            raise self._unavailable_error(failed.decode("utf-8", "replace").strip().rpartition("\n")[2])
        found: Json = json.loads(told)
        return found

    async def checkpoint(self) -> None:
        """Write one now. Never fails: ``mark_error`` tells."""
        try:
            await self._writer.run_in_thread(self._chain.write_checkpoint)
            self.checkpoint_error = None
        except OSError as error:
            self.checkpoint_error = error

    async def close(self) -> None:
        """Write what waits and a last checkpoint. Idempotent; nothing may be recorded afterwards."""
        timer, self._timer = self._timer, None
        if timer is None:
            return
        timer.cancel()
        await asyncio.wait([timer])
        await self._writer.flush()
        await self.checkpoint()
        await self._writer.run_in_thread(self._chain.close)
        await self._writer.close()

    # --- within ----------------------------------------------------------------------------------------------------

    async def _write_checkpoints(self) -> None:
        rounds = round(CHECKPOINT_INTERVAL_S / AUDIT_RETRY_INTERVAL_S)
        while True:
            for _ in range(rounds):
                await asyncio.sleep(AUDIT_RETRY_INTERVAL_S)
                self._retry()
            await self.checkpoint()

    def _retry(self) -> None:
        lost = self._writer.dropped
        if lost > self._reported_losses and self.ok:
            self.record_nowait(AuditEntry("audit.lost", params={"records": lost - self._reported_losses}))
            self._reported_losses = lost
        self._writer.retry()

    def _append_batch(self, bodies: Sequence[Json]) -> list[int]:
        """In the thread. What was found when the files were opened is told before everything else."""
        try:
            entries = self._chain.open()
            self.records_missing = self.records_missing or any(entry.what == RECORDS_MISSING for entry in entries)
            found = [entry_json(entry, self._now_ms()) for entry in entries]
            return self._chain.append([*found, *bodies])[len(found) :]
        except OSError as error:
            raise self._unavailable_error(error.strerror or str(error)) from error

    def _unavailable_error(self, reason: str) -> AuditUnavailable:
        return AuditUnavailable("audit.unavailable", file=str(self.paths.current), reason=reason)

    def _now_ms(self) -> int:
        return int(self._wall_clock().timestamp() * 1000)

    @staticmethod
    async def _in_thread(function: Callable[[], Json]) -> Json:
        """In another thread than the writer's: reading never delays a record."""
        return await asyncio.get_running_loop().run_in_executor(None, function)
