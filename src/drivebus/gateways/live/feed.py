"""Hears the plant once for everybody: one subscription, and one more for each kind of frames that somebody watches."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from fnmatch import fnmatchcase
from typing import Any

from drivebus.errors import DrivebusError
from drivebus.gateways.live.channel import Channel, Ear
from drivebus.gateways.live.mirror import Mirror
from drivebus.plant.access.rights import Right
from drivebus.plant.actor import Actor
from drivebus.plant.client import PlantClient
from drivebus.seams import wall_ms

Json = dict[str, Any]
Patterns = tuple[str, ...]

ALWAYS: Patterns = ("drives/*", "buses/*", "groups/*", "alarms", "plant", "events")
FRAMES = "frames/"
"""Decoding frames costs the plant something: only what is watched is asked for."""
_SELF = Actor("web", frozenset({Right.VIEW}), "web-live", address="local")

_log = logging.getLogger(__name__)


class Feed:
    """What the plant tells at one interval. It is heard while anybody listens."""

    def __init__(self, plant: PlantClient, interval_s: float, wall: Callable[[], int] = wall_ms) -> None:
        self._plant, self._interval_s, self._wall_ms = plant, interval_s, wall
        self._mirror = Mirror()
        self._has_begun = False
        self._channels: dict[tuple[Patterns, float], Channel] = {}
        self._heard: dict[Patterns, asyncio.Task[None]] = {}

    def join(self, ear: Ear, patterns: Patterns, interval_s: float) -> Channel:
        """From now on ``ear`` is told: a snapshot as soon as the plant has begun, then deltas."""
        key = patterns, interval_s
        channel = self._channels.get(key)
        if channel is None:
            channel = self._channels[key] = Channel(self._mirror, patterns, interval_s, self._wall_ms)
        channel.join(ear, tell=self._has_begun)
        self._hear()
        return channel

    def leave(self, ear: Ear, channel: Channel) -> None:
        """Idempotent."""
        channel.leave(ear)
        self._channels = {key: one for key, one in self._channels.items() if one.ears}
        self._hear()

    def close(self, reason: str) -> None:
        """Tell everybody why, and hear nothing more."""
        ears = [ear for channel in self._channels.values() for ear in channel.ears]
        for ear in ears:
            ear.close(reason)
        for channel in self._channels.values():
            channel.end()
        self._channels = {}
        self._hear()

    def _hear(self) -> None:
        """Begin and end subscriptions as those who listen want them."""
        wanted = self._wanted()
        for patterns in wanted - self._heard.keys():
            self._heard[patterns] = asyncio.create_task(self._listen(patterns), name="live-feed")
        for patterns in self._heard.keys() - wanted:
            self._heard.pop(patterns).cancel()
            self._forget(patterns, wanted)

    def _wanted(self) -> set[Patterns]:
        asked = {pattern for channel in self._channels.values() for pattern in channel.patterns}
        frames = {(f"{FRAMES}*" if one == "*" else one,) for one in asked if one == "*" or one.startswith(FRAMES)}
        return {ALWAYS, *frames} if self._channels else set()

    def _forget(self, patterns: Patterns, wanted: set[Patterns]) -> None:
        """What is no longer heard must not stand here as if it were new."""
        if patterns == ALWAYS:
            self._mirror, self._has_begun = Mirror(), False
            return
        for topic in [topic for topic in self._mirror.lists if fnmatchcase(topic, patterns[0])]:
            if not any(fnmatchcase(topic, one) for others in wanted for one in others):
                self._mirror.forget(topic)

    async def _listen(self, patterns: Patterns) -> None:
        """One subscription until its end, which is everybody's."""
        reason = "plant"
        try:
            async for message in self._plant.live(patterns, _SELF, self._interval_s):
                if message["type"] == "closed":
                    reason = "shutdown" if message["reason"] == "shutdown" else "plant"
                    break
                self._take(patterns, message)
        except DrivebusError as error:
            _log.warning("live: %s", error)
        except Exception:
            _log.exception("live: the plant can't be understood")
        self.close(reason)

    def _take(self, patterns: Patterns, message: Json) -> None:
        begins = patterns == ALWAYS and message["type"] == "snapshot"
        if begins:
            self._mirror.clear()
        change = self._mirror.take(message, asyncio.get_running_loop().time())
        self._has_begun = self._has_begun or begins
        for channel in tuple(self._channels.values()):
            if begins:
                channel.begin_anew()
            elif self._has_begun:
                channel.heard(change)
