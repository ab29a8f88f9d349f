"""``DenialLog``: denied requests in the audit trail, bounded so that a flood of them cannot fill the disk."""

from __future__ import annotations

import asyncio
from typing import Protocol

from drivebus.clock import Clock
from drivebus.errors import DrivebusError
from drivebus.service.auth.actor import Actor
from drivebus.types import Json

SUMMARY_PERIOD_S = 30.0
MAX_KINDS_PER_PERIOD = 16  # further kinds are counted together: at most 25 MB of audit trail a day
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


class DenialLog:
    """Records the first denial of a kind at once, counts the others, and records their number after the period."""

    def __init__(self, client: AuditRecorder, clock: Clock) -> None:
        self.client = client
        self.clock = clock
        self._counts: dict[tuple[str, str, str, str], int] = {}
        self._period_start = -SUMMARY_PERIOD_S
        self._flush_task: asyncio.Task[None] | None = None

    async def record_denial(self, method: str, target: str, reason: str, actor: Actor) -> None:
        """``target`` is the path of the route table, ``reason`` the key of the error."""
        if await self.is_new(method, target, reason, actor):
            await try_record(self.client, _denial_entry((method, target, reason, _who(actor)), 1), actor)

    async def is_new(self, method: str, target: str, reason: str, actor: Actor) -> bool:
        """Count a denial; return whether it is the first of its kind in this period, which the caller records."""
        if self.clock() - self._period_start >= SUMMARY_PERIOD_S:
            await self.flush()
            self._period_start = self.clock()
        kind = (method, target, reason, _who(actor))
        if kind not in self._counts and len(self._counts) >= MAX_KINDS_PER_PERIOD:
            kind = ("*", "*", "*", "*")
        if kind in self._counts or kind[0] == "*":
            self._counts[kind] = self._counts.get(kind, 0) + 1
            if self._flush_task is None or self._flush_task.done():
                self._flush_task = asyncio.get_running_loop().create_task(self._flush_later(), name="denial log")
            return False
        self._counts[kind] = 0
        return True

    async def _flush_later(self) -> None:
        await asyncio.sleep(SUMMARY_PERIOD_S)
        await self.flush()

    async def flush(self) -> None:
        """Record the number of repetitions."""
        counted, self._counts = self._counts, {}
        for kind, times in counted.items():
            if times:
                await try_record(self.client, _denial_entry(kind, times), ANONYMOUS)


def _who(actor: Actor) -> str:
    return f"{actor.name}@{actor.address}"


def _denial_entry(kind: tuple[str, str, str, str], times: int) -> Json:
    method, target, reason, who = kind
    return {
        "what": "refused",
        "target": f"{method} {target}",
        "params": {"who": who, "times": times},
        "outcome": reason,
    }
