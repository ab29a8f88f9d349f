"""The address ``/api/v1/live``."""

from __future__ import annotations

from fastapi import APIRouter
from starlette.websockets import WebSocket

from drivebus.gateways.live.asked import DEFAULT, DEFAULT_S, LEAST_S, interval, patterns
from drivebus.gateways.live.feed import Feed
from drivebus.gateways.live.listener import Listener
from drivebus.plant.client import PlantClient

MOST = 300
"""WebSockets at a time; each costs memory, and nobody looks at so many pages."""


class Live:
    """All WebSockets of one process, over one subscription to the plant; a second, faster one while somebody asks."""

    def __init__(self, plant: PlantClient) -> None:
        self._plant = plant
        self._usual, self._fast = Feed(plant, DEFAULT_S), Feed(plant, LEAST_S)
        self.open = 0

    async def serve(self, socket: WebSocket) -> None:
        """One client from its first byte to its last. Whether it may come in, the door has decided."""
        await socket.accept()
        query = socket.query_params
        try:
            chosen = patterns(query["topics"].split(",")) if "topics" in query else DEFAULT
            interval_s = interval(query.get("interval"))
        except ValueError:
            return await socket.close(4400, "message")
        if self.open >= MOST:
            return await socket.close(1013, "many")
        self.open += 1
        try:
            feed = self._usual if interval_s >= DEFAULT_S else self._fast
            await Listener(socket, self._plant, feed, interval_s).run(chosen)
        finally:
            self.open -= 1
        return None


def live_router(plant: PlantClient) -> APIRouter:
    """``WS /api/v1/live?topics=drives/*,alarms&interval=0.25``."""
    router = APIRouter(prefix="/api/v1")
    router.add_api_websocket_route("/live", Live(plant).serve, name="live")
    return router
