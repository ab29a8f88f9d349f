"""``ServiceHealth``: whether the service behind the web gateway answers, and what it can't write."""

from __future__ import annotations

import asyncio
import json
from math import inf

from drivebus.errors import DrivebusError, ServiceUnavailable
from drivebus.service.api.operations.plant import PLANT_GET
from drivebus.service.auth.actor import Actor
from drivebus.service.auth.rights import Right
from drivebus.service.ipc.service_client import ServiceClient, ServiceErrorReply

HEALTH_INTERVAL_S = 1.0  # between two checks of the service, however many clients ask
HEALTH_TIMEOUT_S = 2.0  # a service that does not answer within it counts as hanging
HEALTH_ACTOR = Actor("web", frozenset({Right.VIEW}), "web-health", address="local")


class ServiceHealth:
    """Health of the service: one check serves all clients."""

    def __init__(self, client: ServiceClient) -> None:
        self._client = client
        self._checked_at = -inf
        self._check_task: asyncio.Task[list[str] | None] | None = None

    async def write_failures(self) -> list[str] | None:
        """Return what the service can't write; None where it has not answered within ``HEALTH_TIMEOUT_S``."""
        now = asyncio.get_running_loop().time()
        if self._check_task is None or (self._check_task.done() and now - self._checked_at >= HEALTH_INTERVAL_S):
            self._checked_at = now
            self._check_task = asyncio.create_task(self._check(), name="health")
        return await asyncio.shield(self._check_task)

    async def _check(self) -> list[str] | None:
        try:
            async with asyncio.timeout(HEALTH_TIMEOUT_S):
                plant = json.loads(await self._client.call_json(PLANT_GET.name, {}, HEALTH_ACTOR))
        except (TimeoutError, ServiceUnavailable):
            return None
        except (DrivebusError, ServiceErrorReply):
            return []
        return list(plant.get("write_failures", ()))
