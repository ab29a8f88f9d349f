"""Hears the plant once for everybody: one subscription, and one more for each kind of frames that somebody watches."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from fnmatch import fnmatchcase
from typing import Any

from drivebus.clock import wall_ms
from drivebus.errors import DrivebusError
from drivebus.service.auth.actor import Actor
from drivebus.service.auth.rights import Right
from drivebus.service.ipc.service_client import ServiceClient
from drivebus.web.live.cache import TopicCache
from drivebus.web.live.fanout import FanoutGroup, Subscriber

Json = dict[str, Any]
Patterns = tuple[str, ...]

BASE_PATTERNS: Patterns = ("drives/*", "buses/*", "groups/*", "alarms", "plant", "events")
FRAMES_PREFIX = "frames/"
"""Decoding frames costs the plant something: only what is watched is asked for."""
_LIVE_ACTOR = Actor("web", frozenset({Right.VIEW}), "web-live", address="local")

_log = logging.getLogger(__name__)


class UpstreamFeed:
    """What the plant tells at one interval. It is heard while anybody listens."""

    def __init__(self, plant: ServiceClient, interval_s: float, wall: Callable[[], int] = wall_ms) -> None:
        self._service, self._interval_s, self._wall_ms = plant, interval_s, wall
        self._cache = TopicCache()
        self._has_snapshot = False
        self._groups: dict[tuple[Patterns, float], FanoutGroup] = {}
        self._subscriptions: dict[Patterns, asyncio.Task[None]] = {}

    def join(self, ear: Subscriber, patterns: Patterns, interval_s: float) -> FanoutGroup:
        """From now on ``ear`` is told: a snapshot as soon as the plant has begun, then deltas."""
        key = patterns, interval_s
        channel = self._groups.get(key)
        if channel is None:
            channel = self._groups[key] = FanoutGroup(self._cache, patterns, interval_s, self._wall_ms)
        channel.join(ear, send_snapshot=self._has_snapshot)
        self._update_subscriptions()
        return channel

    def leave(self, ear: Subscriber, channel: FanoutGroup) -> None:
        """Idempotent."""
        channel.leave(ear)
        self._groups = {key: one for key, one in self._groups.items() if one.subscribers}
        self._update_subscriptions()

    def close(self, reason: str) -> None:
        """Tell everybody why, and hear nothing more."""
        ears = [ear for channel in self._groups.values() for ear in channel.subscribers]
        for ear in ears:
            ear.close(reason)
        for channel in self._groups.values():
            channel.cancel_timer()
        self._groups = {}
        self._update_subscriptions()

    def _update_subscriptions(self) -> None:
        """Begin and end subscriptions as those who listen want them."""
        wanted = self._wanted()
        for patterns in wanted - self._subscriptions.keys():
            self._subscriptions[patterns] = asyncio.create_task(self._listen(patterns), name="live-feed")
        for patterns in self._subscriptions.keys() - wanted:
            self._subscriptions.pop(patterns).cancel()
            self._discard_topics(patterns, wanted)

    def _wanted(self) -> set[Patterns]:
        asked = {pattern for channel in self._groups.values() for pattern in channel.patterns}
        frames = {
            (f"{FRAMES_PREFIX}*" if one == "*" else one,)
            for one in asked
            if one == "*" or one.startswith(FRAMES_PREFIX)
        }
        return {BASE_PATTERNS, *frames} if self._groups else set()

    def _discard_topics(self, patterns: Patterns, wanted: set[Patterns]) -> None:
        """What is no longer heard must not stand here as if it were new."""
        if patterns == BASE_PATTERNS:
            self._cache, self._has_snapshot = TopicCache(), False
            return
        for topic in [topic for topic in self._cache.lists if fnmatchcase(topic, patterns[0])]:
            if not any(fnmatchcase(topic, one) for others in wanted for one in others):
                self._cache.remove(topic)

    async def _listen(self, patterns: Patterns) -> None:
        """One subscription until its end, which is everybody's."""
        reason = "plant"
        try:
            async for message in self._service.live(patterns, _LIVE_ACTOR, self._interval_s):
                if message["type"] == "closed":
                    reason = "shutdown" if message["reason"] == "shutdown" else "plant"
                    break
                self._on_message(patterns, message)
        except DrivebusError as error:
            _log.warning("live: %s", error)
        except Exception:
            _log.exception("live: the plant can't be understood")
        self.close(reason)

    def _on_message(self, patterns: Patterns, message: Json) -> None:
        begins = patterns == BASE_PATTERNS and message["type"] == "snapshot"
        if begins:
            self._cache.clear()
        change = self._cache.apply(message, asyncio.get_running_loop().time())
        self._has_snapshot = self._has_snapshot or begins
        for channel in tuple(self._groups.values()):
            if begins:
                channel.restart()
            elif self._has_snapshot:
                channel.on_change(change)
