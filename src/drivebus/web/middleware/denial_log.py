"""What was refused at the door, told to the audit trail: each kind at once, repetitions as one entry with their number,
so that a flood of requests can't fill the disk (S01, S14).
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field

from drivebus.clock import Clock
from drivebus.errors import DrivebusError
from drivebus.service.auth.actor import Actor
from drivebus.service.ipc.service_client import Json, ServiceClient

SUMMARY_PERIOD_S = 30.0
MAX_KINDS_PER_PERIOD = 16
"""So many different ones are told in a period, what is beyond is counted together: at most 25 MB a day."""
_RECORD_TIMEOUT_S = 2.0


async def try_record(client: ServiceClient, entry: Json, actor: Actor) -> bool:
    """Put into the trail; False where the plant can't be reached in time. For what must not wait for the trail."""
    try:
        async with asyncio.timeout(_RECORD_TIMEOUT_S):
            await client.record(entry, actor)
    except (TimeoutError, OSError, DrivebusError):
        return False
    return True


@dataclass(slots=True)
class DenialLog:
    """Tells the first of a kind, counts the others, and tells their number when the period is over."""

    client: ServiceClient
    clock: Clock
    _counts: dict[tuple[str, str, str, str], int] = field(default_factory=dict)
    _period_start: float = -SUMMARY_PERIOD_S
    _flush_task: asyncio.Task[None] | None = None

    async def record_denial(self, what: str, target: str, why: str, actor: Actor) -> None:
        """``what`` is the method, ``target`` the address as the table has it, ``why`` the error's key."""
        if self.clock() - self._period_start >= SUMMARY_PERIOD_S:
            await self.flush()
            self._period_start = self.clock()
        kind = (what, target, why, f"{actor.name}@{actor.address}")
        if kind not in self._counts and len(self._counts) >= MAX_KINDS_PER_PERIOD:
            kind = ("*", "*", "*", "*")
        if kind in self._counts or kind[0] == "*":
            self._counts[kind] = self._counts.get(kind, 0) + 1
            if self._flush_task is None or self._flush_task.done():
                self._flush_task = asyncio.get_running_loop().create_task(self._flush_later(), name="refusals")
            return
        self._counts[kind] = 0
        await try_record(self.client, _denial_entry(kind, 1), actor)

    async def _flush_later(self) -> None:
        await asyncio.sleep(SUMMARY_PERIOD_S)
        await self.flush()

    async def flush(self) -> None:
        """Tell the repetitions."""
        counted, self._counts = self._counts, {}
        for kind, times in counted.items():
            if times:
                await try_record(self.client, _denial_entry(kind, times), ANONYMOUS)


ANONYMOUS = Actor("", frozenset(), "", remote=True, address="")
"""Who did not say who it is."""


def _denial_entry(kind: tuple[str, str, str, str], times: int) -> Json:
    what, target, why, who = kind
    return {"what": "refused", "target": f"{what} {target}", "params": {"who": who, "times": times}, "outcome": why}
