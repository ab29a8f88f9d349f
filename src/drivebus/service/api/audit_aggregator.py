"""``AuditAggregator``: audit records of the same kind are counted, so that no flood fills the disk."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import NamedTuple, Protocol

from drivebus.clock import Clock
from drivebus.errors import DrivebusError
from drivebus.service.audit.records import OTHERS
from drivebus.service.auth.actor import Actor
from drivebus.types import Json

SUMMARY_PERIOD_S = 30.0  # the repetitions of a period are recorded together
MAX_KINDS_PER_PERIOD = 16  # further kinds of a user are counted together: at most 25 MB of audit trail a day
COUNTED = "counted"  # outcome of commands that were done and are recorded as a count only
_RECORD_TIMEOUT_S = 2.0  # a response never waits longer for the audit trail
ANONYMOUS = Actor("", frozenset(), "", remote=True, address="")


class AuditRecorder(Protocol):
    """Writer of audit records: the client of a service, or the service itself."""

    async def record(self, entry: Json, actor: Actor, /) -> None:
        """Write an event. Raises AuditUnavailable, ServiceUnavailable."""
        ...


async def try_record(client: AuditRecorder, entry: Json, actor: Actor) -> bool:
    """Write ``entry`` into the audit trail; False where the service does not do so in time."""
    try:
        async with asyncio.timeout(_RECORD_TIMEOUT_S):
            await client.record(entry, actor)
    except (TimeoutError, OSError, DrivebusError):
        return False
    return True


class RecordKind(NamedTuple):
    """Denied requests, or commands beyond a budget, that count as repetitions of each other."""

    what: str
    """``refused``, or the operation of commands that are recorded as a count only."""
    target: str
    """Method and path of the route table, name of an operation, or what the command is for."""
    outcome: str
    """Key of the error; ``counted`` for commands."""
    client: str
    """Name and address of the actor."""
    user: str
    """Name of the actor's user; empty for a client without an account, which may send ever new names."""

    @classmethod
    def of(cls, what: str, target: str, outcome: str, actor: Actor) -> RecordKind:
        return cls(what, target, outcome, f"{actor.name}@{actor.address}", actor.user)

    @property
    def others(self) -> RecordKind:
        """Stands for this kind beyond ``MAX_KINDS_PER_PERIOD``: a count never loses whose commands it counts."""
        outcome = self.outcome if self.outcome == COUNTED else OTHERS
        return RecordKind(self.what, OTHERS, outcome, self.user, self.user)


class AuditAggregator:
    """Records the first request of a kind at once, counts the others, and records their number after the period."""

    def __init__(self, client: AuditRecorder, clock: Clock) -> None:
        self.client = client
        self.clock = clock
        self._counts: dict[RecordKind, int] = {}
        self._period_start = -SUMMARY_PERIOD_S
        self._flush_task: asyncio.Task[None] | None = None
        self._closing = asyncio.Event()

    async def record_denial(self, method: str, target: str, reason: str, actor: Actor) -> None:
        """Count a denial, and record it if it is the first of its kind in this period."""
        kind = RecordKind.of("refused", f"{method} {target}", reason, actor)
        if await self.count(kind):
            await try_record(self.client, _count_entry(kind, 1), actor)

    async def count(self, kind: RecordKind) -> bool:
        """Count one of a kind; return whether it is the first in this period, which the caller records.

        At the end of the process there is no later count, so that the caller records each of them.
        """
        if self.clock() - self._period_start >= SUMMARY_PERIOD_S:
            await self.flush()
            self._period_start = self.clock()
        if self._closing.is_set():
            return True
        is_other = kind not in self._counts and len(self._counts) >= MAX_KINDS_PER_PERIOD
        kind = kind.others if is_other else kind
        if is_other or kind in self._counts:
            self._counts[kind] = self._counts.get(kind, 0) + 1
            if self._flush_task is None or self._flush_task.done():
                self._flush_task = asyncio.get_running_loop().create_task(self._flush_later(), name="audit aggregator")
            return False
        self._counts[kind] = 0
        return True

    async def _flush_later(self) -> None:
        with suppress(TimeoutError):
            await asyncio.wait_for(self._closing.wait(), SUMMARY_PERIOD_S)
        await self.flush()

    async def close(self) -> None:
        """Record the number of repetitions now, at the end of the process, and count no later request."""
        self._closing.set()
        if self._flush_task is not None:  # each count has one
            await self._flush_task

    async def flush(self) -> None:
        """Record the number of repetitions."""
        counted, self._counts = self._counts, {}
        for kind, times in counted.items():
            if times:
                await try_record(self.client, _count_entry(kind, times), ANONYMOUS)


def _count_entry(kind: RecordKind, times: int) -> Json:
    return {
        "what": kind.what,
        "target": kind.target,
        "params": {"who": kind.client, "times": times},
        "outcome": kind.outcome,
    }
