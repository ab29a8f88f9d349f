"""Asynchronous audit trail of the service.

``record`` returns when the record is durable and raises ``AuditUnavailable`` where it cannot be: no start without its
record. ``record_nowait`` never waits and never fails, because a stop is sent before it is recorded; its record is
written as soon as the disk works again.
"""

from __future__ import annotations

import asyncio
import json
import logging
from asyncio.subprocess import PIPE
from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path

from drivebus import clock, i18n
from drivebus.errors import AuditUnavailable, SystemReason
from drivebus.service.audit.chain import (
    HEAD_MISSING,
    KEY_REPLACED,
    MAX_AUDIT_FILE_BYTES,
    RECORDS_MISSING,
    AuditChain,
    AuditPaths,
)
from drivebus.service.audit.query import query_records
from drivebus.service.audit.records import AuditCheckpoint, AuditEntry, entry_json
from drivebus.service.config.model import PlantConfig
from drivebus.service.one_at_a_time import OneAtATime, run_to_end_in_thread
from drivebus.service.process.module_command import module_command
from drivebus.service.storage.batch_writer import BatchWriter
from drivebus.types import Json

LOG = logging.getLogger("drivebus.service")
CHECKPOINT_INTERVAL_S = 60.0
"""Records after the last checkpoint can be cut off undetected: at most those of one minute."""
AUDIT_RETRY_INTERVAL_S = 5.0
"""Interval of attempts to write to a failed disk, also while no operation is waiting for it."""
LOG_INTERVAL_MS = 3_600_000  # a checkpoint in the log each hour, at the start and at the end


class AuditTrail:
    """Audit trail in ``folder``. ``checkpoints``, ``key`` and ``head`` may be on another disk (see ``AuditPaths``)."""

    def __init__(
        self,
        folder: Path,
        checkpoints: Path | None = None,
        key: Path | None = None,
        head: Path | None = None,
        *,
        wall_clock: Callable[[], datetime] = clock.wall_clock,
        max_file_bytes: int = MAX_AUDIT_FILE_BYTES,
    ) -> None:
        self.paths = AuditPaths.of(folder, checkpoints, key, head)
        self._wall_clock = wall_clock
        self._chain = AuditChain(self.paths, self._now_ms, max_file_bytes)
        self._writer: BatchWriter[Json, int] = BatchWriter("audit", self._append_batch)
        self._timer: asyncio.Task[None] | None = None
        self._reported_losses = 0
        self.records_missing = False
        """Whether records or checkpoints were missing when the trail was opened: its end was cut off."""
        self.key_replaced = False
        """Whether the last checkpoint or the head was not made with the key when the trail was opened."""
        self.head_missing = False
        """Whether there were checkpoints and no head when the trail was opened."""
        self.checkpoint_error: OSError | None = None
        """Error of the last checkpoint; it does not prevent starts."""
        self.head_error: OSError | None = None
        """Error of the last write of the head; it does not prevent starts."""
        self._logged_ms: int | None = None
        self._queries, self._verifications = OneAtATime(), OneAtATime()

    @classmethod
    def of(cls, config: PlantConfig) -> AuditTrail:
        """Return the trail of a plant, with the files that its configuration names. Not opened yet."""
        return cls(config.directory, config.audit.checkpoints, config.audit.key, config.audit.head)

    @property
    def ok(self) -> bool:
        """Whether the last write succeeded."""
        return self._writer.error is None

    @property
    def error(self) -> Exception | None:
        """Error of the last write; None if it succeeded."""
        return self._writer.error

    async def open(self) -> None:
        """Open the trail and start writing checkpoints, the first one for records of an earlier run.

        Never raises: a failure shows in ``ok`` and is tried again.
        """
        self._timer = asyncio.get_running_loop().create_task(self._write_checkpoints(), name="audit checkpoints")
        try:
            await self.record(AuditEntry(what="audit.opened"))
        except AuditUnavailable:
            self.record_nowait(AuditEntry(what="audit.opened"))
            return
        await self.checkpoint()

    async def record(self, entry: AuditEntry) -> int:
        """Write a record durably and return its number.

        Raises AuditUnavailable; the caller then uses ``record_nowait`` for the refusal, so that the disk is tried
        again.
        """
        return await self._writer.write(entry_json(entry, self._now_ms()))

    def record_nowait(self, entry: AuditEntry) -> None:
        """Queue a record, to be written now or when the disk works again. Never waits, never raises."""
        self._writer.write_nowait(entry_json(entry, self._now_ms()))

    async def query(
        self, *, from_ms: int, to_ms: int, drive: str | None = None, cursor: str | None = None, limit: int = 100
    ) -> Json:
        """Return ``{"items", "next"}``, newest first.

        Raises InvalidParameters for an unknown cursor, OSError, and ServiceUnavailable where too many are waiting.
        """

        # On a thread other than the writer's, so that reading never delays a record; on one at a time, because several
        # would delay the buses and occupy the threads that store settings.
        def read() -> Json:
            return query_records(self.paths, from_ms=from_ms, to_ms=to_ms, drive=drive, cursor=cursor, limit=limit)

        return await self._queries.run(lambda: run_to_end_in_thread(read))

    async def verify(self) -> Json:
        """Verify the files and return the report.

        Raises AuditUnavailable if they cannot be read, ServiceUnavailable where too many are waiting. A separate
        process reads them, one at a time, so that a long trail and many requests delay no bus.
        """
        return await self._verifications.run(self._verify_in_process)

    async def _verify_in_process(self) -> Json:
        paths = (self.paths.folder, self.paths.checkpoints, self.paths.key, self.paths.head)
        command = module_command("drivebus.service.audit", *map(str, paths))
        # In the process group of the service, Ctrl-Z in its terminal would suspend the child: no report would come.
        child = await asyncio.create_subprocess_exec(*command, stdout=PIPE, stderr=PIPE, process_group=0)
        try:
            output, errors = await child.communicate()
        finally:
            if child.returncode is None:
                child.kill()
                await child.wait()
        if child.returncode != 0:
            raise self._unavailable_error(errors.decode("utf-8", "replace").strip().rpartition("\n")[2])
        report: Json = json.loads(output)
        return report

    async def checkpoint(self) -> None:
        """Write a checkpoint and the head now. Never raises: ``checkpoint_error`` and ``head_error`` hold the error."""
        try:
            await self._writer.run_in_thread(self._chain.write_checkpoint)
            self.checkpoint_error = None
        except OSError as error:
            self.checkpoint_error = error
        try:
            written = await self._writer.run_in_thread(self._chain.write_head)
            self.head_error = None
        except OSError as error:
            self.head_error = error
        else:
            if written is not None:
                self._log_checkpoint(written)

    def _log_checkpoint(self, checkpoint: AuditCheckpoint) -> None:
        """Log a checkpoint where it is due: the log is a place that a program with access to the trail cannot edit."""
        closing, logged = self._timer is None, self._logged_ms
        if closing or logged is None or not 0 <= checkpoint.time_ms - logged < LOG_INTERVAL_MS:
            self._logged_ms = checkpoint.time_ms
            n, number, mac = checkpoint.n, checkpoint.number, checkpoint.mac
            text = i18n.preferred_text("log.checkpoint", record=n, checkpoint=number, mac=mac)
            LOG.info(text, extra={"event": {"kind": "checkpoint"}})

    async def close(self) -> None:
        """Write queued records and a last checkpoint, then close the files. Idempotent."""
        timer, self._timer = self._timer, None
        if timer is None:
            return
        timer.cancel()
        await asyncio.wait([timer])
        await self._writer.flush()
        await self.checkpoint()
        await self._writer.close()
        self._chain.close()  # after the last attempt to write, which a full disk may leave half done

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
            self.record_nowait(AuditEntry(what="audit.lost", params={"records": lost - self._reported_losses}))
            self._reported_losses = lost
        self._writer.retry()

    def _append_batch(self, bodies: Sequence[Json]) -> list[int]:
        """Write a batch on the writer's thread, after the entries that report what opening the files found."""
        try:
            entries = self._chain.open()
            self.records_missing = self.records_missing or any(entry.what == RECORDS_MISSING for entry in entries)
            self.head_missing = self.head_missing or any(entry.what == HEAD_MISSING for entry in entries)
            self.key_replaced = self.key_replaced or any(entry.what == KEY_REPLACED for entry in entries)
            records = [entry_json(entry, self._now_ms()) for entry in entries]
            return self._chain.append([*records, *bodies])[len(records) :]
        except OSError as error:
            raise self._unavailable_error(SystemReason(error), error.filename) from error

    def _unavailable_error(self, reason: str | SystemReason, file: str | None = None) -> AuditUnavailable:
        """Return the error; ``file`` is the file that failed, None for that of the records."""
        return AuditUnavailable("audit.unavailable", file=str(file or self.paths.current), reason=reason)

    def _now_ms(self) -> int:
        return int(self._wall_clock().timestamp() * 1000)
