"""The address ``/api/v1/live``."""

from __future__ import annotations

from starlette.websockets import WebSocket

from drivebus.service.auth.rights import Right
from drivebus.service.ipc.service_client import ServiceClient
from drivebus.web.live.messages import (
    DEFAULT_INTERVAL_S,
    DEFAULT_PATTERNS,
    MIN_INTERVAL_S,
    parse_interval,
    parse_patterns,
)
from drivebus.web.live.session import WebSocketSession
from drivebus.web.live.upstream import UpstreamFeed
from drivebus.web.route import WEBSOCKET, AccessRouter

MAX_WEBSOCKETS = 300
"""WebSockets at a time; each costs memory, and nobody looks at so many pages."""


class LiveEndpoint:
    """All WebSockets of one process, over one subscription to the plant; a second, faster one while somebody asks."""

    def __init__(self, plant: ServiceClient) -> None:
        self._service = plant
        self._usual, self._fast = UpstreamFeed(plant, DEFAULT_INTERVAL_S), UpstreamFeed(plant, MIN_INTERVAL_S)
        self.open = 0

    async def serve(self, socket: WebSocket) -> None:
        """One client from its first byte to its last. Whether it may come in, the door has decided."""
        await socket.accept()
        query = socket.query_params
        try:
            chosen = parse_patterns(query["topics"].split(",")) if "topics" in query else DEFAULT_PATTERNS
            interval_s = parse_interval(query.get("interval"))
        except ValueError:
            return await socket.close(4400, "message")
        if self.open >= MAX_WEBSOCKETS:
            return await socket.close(1013, "many")
        self.open += 1
        try:
            feed = self._usual if interval_s >= DEFAULT_INTERVAL_S else self._fast
            await WebSocketSession(socket, self._service, feed, interval_s).run(chosen)
        finally:
            self.open -= 1
        return None


router = AccessRouter("/api/v1")


@router.route(WEBSOCKET, "/live", access=Right.VIEW, name="live")
async def live(socket: WebSocket) -> None:
    """``WS /api/v1/live?topics=drives/*,alarms&interval=0.25``."""
    endpoint: LiveEndpoint = socket.app.state.live
    await endpoint.serve(socket)
