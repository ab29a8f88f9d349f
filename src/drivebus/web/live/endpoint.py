"""WebSocket endpoint ``/api/v1/live``."""

from __future__ import annotations

from starlette.websockets import WebSocket

from drivebus.gateways.upstream import UpstreamFeed
from drivebus.service.api.operations import API_PREFIX
from drivebus.service.auth.actor import Actor
from drivebus.service.auth.rights import Right
from drivebus.service.ipc.service_client import ServiceClient
from drivebus.service.user_quota import UserQuota
from drivebus.web.context import credential_of
from drivebus.web.live.messages import DEFAULT_PATTERNS, parse_interval, parse_patterns
from drivebus.web.live.session import WebSocketSession, close_socket
from drivebus.web.route import WEBSOCKET, AccessRouter

MAX_WEBSOCKETS = 300  # each costs memory; sessions and tokens of a user share one quota
LIVE_ACTOR = Actor("web", frozenset({Right.VIEW}), "web-live", address="local")


class LiveEndpoint:
    """All WebSockets of one process, over one subscription to the service."""

    def __init__(self, service: ServiceClient) -> None:
        self._service = service
        self._feed = UpstreamFeed(service, LIVE_ACTOR)
        self._quota = UserQuota(MAX_WEBSOCKETS)

    @property
    def open(self) -> int:
        """Number of WebSockets that are open."""
        return self._quota.held

    def close(self, reason: str) -> None:
        """Close every WebSocket with a reason of ``CLOSE_CODES``."""
        self._feed.close(reason)

    async def serve(self, socket: WebSocket) -> None:
        """Serve one client to its end. The authentication middleware has admitted it."""
        await socket.accept()
        query = socket.query_params
        try:
            patterns = parse_patterns(query["topics"].split(",")) if "topics" in query else DEFAULT_PATTERNS
            interval_s = parse_interval(query.get("interval"))
        except ValueError:
            return await close_socket(socket, "bad_message")
        user = credential_of(socket).actor.user
        if not self._quota.has_place(user):
            return await close_socket(socket, "many")
        with self._quota.place(user):
            await WebSocketSession(socket, self._service, self._feed, interval_s).run(patterns)
        return None


router = AccessRouter()


@router.exempt(WEBSOCKET, f"{API_PREFIX}/live", access=Right.VIEW)
async def live(socket: WebSocket) -> None:
    """``WS /api/v1/live?topics=drives/*,alarms&interval=0.25``."""
    endpoint: LiveEndpoint = socket.app.state.live
    await endpoint.serve(socket)
