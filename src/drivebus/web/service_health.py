"""``ServiceHealth``: whether the service behind the web gateway answers."""

from __future__ import annotations

import asyncio
from math import inf

from drivebus.errors import DrivebusError, ServiceUnavailable
from drivebus.service.api.operations.plant import PLANT_GET
from drivebus.service.auth.actor import Actor
from drivebus.service.auth.rights import Right
from drivebus.service.ipc.service_client import ServiceClient, ServiceErrorReply

HEALTH_INTERVAL_S = 1.0  # between questions to the service, however many clients want to know
HEALTH_TIMEOUT_S = 2.0
HEALTH_ACTOR = Actor("web", frozenset({Right.VIEW}), "web-health", address="local")


class ServiceHealth:
    """Whether the service answers; one question serves all clients."""

    def __init__(self, client: ServiceClient) -> None:
        self._client = client
        self._asked_at = -inf
        self._answer: asyncio.Task[bool] | None = None

    async def service_answers(self) -> bool:
        """Return whether the service has answered within ``HEALTH_TIMEOUT_S``."""
        now = asyncio.get_running_loop().time()
        if self._answer is None or (self._answer.done() and now - self._asked_at >= HEALTH_INTERVAL_S):
            self._asked_at = now
            self._answer = asyncio.create_task(self._ask(), name="health")
        return await asyncio.shield(self._answer)

    async def _ask(self) -> bool:
        try:
            async with asyncio.timeout(HEALTH_TIMEOUT_S):
                await self._client.call_json(PLANT_GET.name, {}, HEALTH_ACTOR)
        except (TimeoutError, ServiceUnavailable):
            return False
        except (DrivebusError, ServiceErrorReply):
            return True
        return True
