"""``SessionEndWatch``: control of drives ends with the session or token that has it, not ten seconds later."""

from __future__ import annotations

import asyncio
from contextlib import suppress

from drivebus.errors import DrivebusError
from drivebus.service.auth.credentials import Credential
from drivebus.service.auth.rights import Right
from drivebus.service.ipc.service_client import ServiceClient


class SessionEndWatch:
    """Reports to the service when a credential that may control drives ends, or loses that right."""

    def __init__(self, client: ServiceClient) -> None:
        self._client = client
        self._tasks: dict[str, asyncio.Task[None]] = {}
        """By the session of the actor: at most one for each session and token."""

    def watch(self, credential: Credential) -> None:
        """Watch a credential that may control drives now. Idempotent."""
        actor = credential.actor
        if actor.may(Right.OPERATE) and actor.session not in self._tasks:
            task = asyncio.create_task(self._report_end(credential), name=f"end of {actor.session}")
            self._tasks[actor.session] = task
            task.add_done_callback(lambda _: self._tasks.pop(actor.session, None))

    async def _report_end(self, credential: Credential) -> None:
        reason = await credential.wait_ended()
        while credential.end_reason is None and credential.actor.may(Right.OPERATE):  # the token lost another right
            reason = await credential.wait_ended()
        with suppress(OSError, DrivebusError):  # of a service that is away, the leases end by themselves
            await self._client.end_control(reason, credential.actor)

    async def close(self) -> None:
        """End the watch with the process: no session renews its leases then, and they end by themselves."""
        tasks = tuple(self._tasks.values())
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
