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

from drivebus import seams
from drivebus.errors import AuditUnavailable
from drivebus.plant.audit.chain import CUT, FULL_AT, Chain
from drivebus.plant.audit.entry import Entry, told
from drivebus.plant.audit.files import Places
from drivebus.plant.audit.listing import listed
from drivebus.plant.grouped import Grouped
from drivebus.plant.view import Json

CHECKPOINT_S = 60.0
"""S12."""
RETRY_S = 5.0
"""A disk that failed is tried again so often, also while nobody wants to start anything."""


class AuditTrail:
    """The trail in ``folder``. ``checkpoints`` and ``key`` may lie on another disk: ``audit.files.Places``."""

    def __init__(
        self,
        folder: Path,
        checkpoints: Path | None = None,
        key: Path | None = None,
        *,
        wall: Callable[[], datetime] = seams.wall_clock,
        full_at: int = FULL_AT,
    ) -> None:
        self.places = Places.of(folder, checkpoints, key)
        self._wall = wall
        self._chain = Chain(self.places, self._now_ms, full_at)
        self._writing: Grouped[Json, int] = Grouped("audit", self._keep)
        self._timer: asyncio.Task[None] | None = None
        self._lost = 0
        self.cut = False
        """When it was opened, records were missing that a checkpoint vouches for: somebody cut them off."""
        self.mark_error: OSError | None = None
        """Why the last checkpoint was not written; starts are not refused for it."""

    @property
    def ok(self) -> bool:
        """Can it be written, as far as the last attempt told?"""
        return self._writing.error is None

    @property
    def error(self) -> Exception | None:
        """Why not."""
        return self._writing.error

    async def open(self) -> None:
        """Make ready, and begin to write checkpoints, the first one for what an earlier life left. Never fails: ``ok``
        tells, and it is tried again."""
        self._timer = asyncio.get_running_loop().create_task(self._run(), name="audit checkpoints")
        try:
            await self.record(Entry("audit.opened"))
        except AuditUnavailable:
            self.note(Entry("audit.opened"))
            return
        await self.checkpoint()

    async def record(self, entry: Entry) -> int:
        """Its number; it is durable when this returns. Raises AuditUnavailable: what then becomes of the wish is to be
        noted, so that the disk is tried again."""
        return await self._writing.put(told(entry, self._now_ms()))

    async def write(self, entry: Json) -> int:
        """``record`` of what is already JSON. Raises AuditUnavailable."""
        return await self.record(Entry.from_json(entry))

    def note(self, entry: Entry) -> None:
        """Written soon, or once the disk works again; waits for nothing and never fails (stops)."""
        self._writing.post(told(entry, self._now_ms()))

    async def entries(
        self, from_ms: int, to_ms: int, drive: str | None = None, cursor: str | None = None, limit: int = 100
    ) -> Json:
        """``{"items", "next"}``, the newest first. Raises ParamsError for a cursor of somebody else's."""
        return await self._aside(lambda: listed(self.places, from_ms, to_ms, drive, cursor, limit))

    async def verify(self) -> Json:
        """``audit.verify``: what the files say about themselves now. Raises AuditUnavailable where they can't be read.

        Another process reads them, so that a long trail delays no bus.
        """
        places = (self.places.folder, self.places.checkpoints, self.places.key)
        command = (sys.executable, "-m", "drivebus.plant.audit", *map(str, places))
        child = await asyncio.create_subprocess_exec(*command, stdout=PIPE, stderr=PIPE)
        try:
            told, failed = await child.communicate()
        finally:
            if child.returncode is None:
                child.kill()
        if child.returncode != 0:
            raise self._unavailable(failed.decode("utf-8", "replace").strip().rpartition("\n")[2])
        found: Json = json.loads(told)
        return found

    async def checkpoint(self) -> None:
        """Write one now. Never fails: ``mark_error`` tells."""
        try:
            await self._writing.run(self._chain.mark)
            self.mark_error = None
        except OSError as error:
            self.mark_error = error

    async def close(self) -> None:
        """Write what waits and a last checkpoint. Idempotent; nothing may be recorded afterwards."""
        timer, self._timer = self._timer, None
        if timer is None:
            return
        timer.cancel()
        await asyncio.wait([timer])
        await self._writing.drain()
        await self.checkpoint()
        await self._writing.run(self._chain.close)
        await self._writing.close()

    # --- within ----------------------------------------------------------------------------------------------------

    async def _run(self) -> None:
        rounds = round(CHECKPOINT_S / RETRY_S)
        while True:
            for _ in range(rounds):
                await asyncio.sleep(RETRY_S)
                self._try_again()
            await self.checkpoint()

    def _try_again(self) -> None:
        lost = self._writing.dropped
        if lost > self._lost and self.ok:
            self.note(Entry("audit.lost", params={"records": lost - self._lost}))
            self._lost = lost
        self._writing.wake()

    def _keep(self, bodies: Sequence[Json]) -> list[int]:
        """In the thread. What was found when the files were opened is told before everything else."""
        try:
            entries = self._chain.open()
            self.cut = self.cut or any(entry.what == CUT for entry in entries)
            found = [told(entry, self._now_ms()) for entry in entries]
            return self._chain.append([*found, *bodies])[len(found) :]
        except OSError as error:
            raise self._unavailable(error.strerror or str(error)) from error

    def _unavailable(self, reason: str) -> AuditUnavailable:
        return AuditUnavailable("audit.unavailable", file=str(self.places.current), reason=reason)

    def _now_ms(self) -> int:
        return int(self._wall().timestamp() * 1000)

    @staticmethod
    async def _aside(function: Callable[[], Json]) -> Json:
        """In another thread than the writer's: reading never delays a record."""
        return await asyncio.get_running_loop().run_in_executor(None, function)
