"""Subscription of a gateway to the service: the state stream once for all clients, and frames only while watched."""

from __future__ import annotations

import asyncio
import logging

from drivebus import i18n
from drivebus.errors import DrivebusError
from drivebus.gateways.cache import TopicCache
from drivebus.gateways.fanout import FanoutGroup, Patterns, Subscriber, matches_topic
from drivebus.service.auth.actor import Actor
from drivebus.service.ipc.service_client import ServiceClient
from drivebus.service.live.hub import FRAMES_PREFIX, STATE_STREAM
from drivebus.types import Json

SERVICE_TIMEOUT_S = 2.0  # the service sends at least one message a second; the page takes as long for a lost connection

_log = logging.getLogger(__name__)


class UpstreamFeed:
    """The cache of one gateway and its groups of subscribers. Connected to the service while there is a subscriber."""

    def __init__(self, service: ServiceClient, actor: Actor) -> None:
        self._service, self._actor = service, actor
        self._cache = TopicCache()
        self._has_snapshot = False
        self._groups: dict[tuple[Patterns, float], FanoutGroup] = {}
        self._streams: dict[str, asyncio.Task[None]] = {}

    def join(self, subscriber: Subscriber, patterns: Patterns, interval_s: float) -> FanoutGroup:
        """Send the subscriber a snapshot as soon as there is one, then deltas; close it where the service is silent.

        A snapshot of a silent service would show its last values as live.
        """
        key = patterns, interval_s
        group = self._groups.get(key)
        if group is None:
            group = self._groups[key] = FanoutGroup(self._cache, patterns, interval_s)
        if self._has_snapshot and self._cache.silence_s(asyncio.get_running_loop().time()) > SERVICE_TIMEOUT_S:
            subscriber.close("upstream_lost")
        else:
            group.join(subscriber, send_snapshot=self._has_snapshot)
        self._update_streams()
        return group

    def leave(self, subscriber: Subscriber, group: FanoutGroup) -> None:
        """Remove a subscriber. Idempotent."""
        group.leave(subscriber)
        self._groups = {key: joined for key, joined in self._groups.items() if joined.subscribers}
        self._update_streams()

    def close(self, reason: str) -> None:
        """Close every subscriber with the reason, and the connection to the service."""
        for group in self._groups.values():
            group.cancel_timer()
            for subscriber in group.subscribers:
                subscriber.close(reason)
        self._groups = {}
        self._update_streams()

    def _update_streams(self) -> None:
        """Start and end streams according to the patterns of the subscribers."""
        required = self._required_streams()
        for stream in required - self._streams.keys():
            self._streams[stream] = asyncio.create_task(self._read(stream), name=f"live {stream}")
        for stream in self._streams.keys() - required:
            self._streams.pop(stream).cancel()
            if stream == STATE_STREAM:
                self._cache.clear()
                self._has_snapshot = False
            else:
                self._cache.remove(stream)

    def _required_streams(self) -> set[str]:
        """Return the streams of the patterns: frames of known buses only, because clients can invent any name.

        Each stream costs the process of the buses a message a second.
        """
        if not self._groups:
            return set()
        patterns = {pattern for group in self._groups.values() for pattern in group.patterns}
        buses = (topic.removeprefix("buses/") for topic in self._cache.topics if topic.startswith("buses/"))
        streams = (f"{FRAMES_PREFIX}{bus}" for bus in buses)
        matching = {stream for stream in streams if any(matches_topic(stream, pattern) for pattern in patterns)}
        return {STATE_STREAM} | matching

    async def _read(self, stream: str) -> None:
        """Read one stream to its end, which ends everything."""
        reason = "upstream_lost"
        try:
            async for message in self._service.live(stream, self._actor):
                if message["type"] == "closed":
                    reason = "shutdown" if message["reason"] == "shutdown" else reason
                    break
                self._on_message(stream, message)
        except DrivebusError as error:
            _log.warning(i18n.preferred_text("log.live_ended", why=error))
        except Exception:
            _log.exception(i18n.preferred_text("log.live_unreadable"))
        self.close(reason)

    def _on_message(self, stream: str, message: Json) -> None:
        starts = stream == STATE_STREAM and message["type"] == "snapshot"
        if starts:
            self._cache.clear()
        change = self._cache.apply(message, asyncio.get_running_loop().time())
        self._has_snapshot = self._has_snapshot or starts
        for group in tuple(self._groups.values()):
            if starts:
                group.restart()
            elif self._has_snapshot:
                group.on_change(change)
        if starts or any(topic.startswith("buses/") for topic in change.removed | change.keys.keys()):
            self._update_streams()
