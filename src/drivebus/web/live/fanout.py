"""All clients that want the same topics at the same rate: what they are told is put together and encoded once."""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import Callable
from fnmatch import fnmatchcase
from typing import Any, Protocol

from drivebus.web.live.cache import MAX_CACHED_ITEMS, TopicCache, TopicChange

Json = dict[str, Any]

MAX_URGENT_DELAY_S = 0.25
"""However seldom a client wants values: changes of state, trust and alarms come this soon (G17)."""
HEARTBEAT_AFTER_S = 0.7
"""After so long in silence the next message of the plant is told on, empty or not. The plant speaks every second at
least, clients hear something every 1.7 s at most: twice that is a lost line."""


class Subscriber(Protocol):
    """One client, as a channel sees it."""

    def offer(self, text: str) -> None:
        """Take a message, or be closed for not taking them; never waits."""
        ...

    def close(self, reason: str) -> None:
        """No more comes: tell why. Never waits."""
        ...


def encode_message(message: Json) -> str:
    return json.dumps(message, ensure_ascii=False, separators=(",", ":"))


class FanoutGroup:
    """Made by ``Feed`` for its first client. ``wall_ms`` labels messages; times are of the loop's clock."""

    def __init__(
        self, mirror: TopicCache, patterns: tuple[str, ...], interval_s: float, wall_ms: Callable[[], int]
    ) -> None:
        self._cache, self.patterns, self.interval_s, self._wall_ms = mirror, patterns, interval_s, wall_ms
        self.subscribers: set[Subscriber] = set()
        self._seq = 0
        self._sent_at = self._delta_sent_at = -math.inf
        """When anything, and when anything new, was told."""
        self._timer: asyncio.TimerHandle | None = None
        self._match_cache: dict[str, bool] = {}
        self._pending = TopicChange()

    def matches(self, topic: str) -> bool:
        found = self._match_cache.get(topic)
        if found is None:
            found = self._match_cache[topic] = any(fnmatchcase(topic, pattern) for pattern in self.patterns)
        return found

    def join(self, ear: Subscriber, *, send_snapshot: bool) -> None:
        """Everybody else is told what is pending first, so that the snapshot is where all of them are.

        ``tell`` False: the plant has not begun; the snapshot comes with ``begin_anew``.
        """
        if send_snapshot and self._has_pending:
            self._send_delta()
        self.subscribers.add(ear)
        if send_snapshot:
            ear.offer(self._snapshot())

    def leave(self, ear: Subscriber) -> None:
        self.subscribers.discard(ear)
        if not self.subscribers:
            self.cancel_timer()

    def restart(self) -> None:
        """The plant began anew: so does everybody."""
        self.cancel_timer()
        self._pending = TopicChange()
        self._sent_at = self._delta_sent_at = asyncio.get_running_loop().time()
        self._offer(self._snapshot())

    def cancel_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def on_change(self, change: TopicChange) -> None:
        """A message of the plant: nothing else makes this channel speak, so where the plant falls silent there is no
        heartbeat either.
        """
        self._add(change)
        now = asyncio.get_running_loop().time() + EARLY_TOLERANCE_S
        if self._has_pending:
            due = self._delta_sent_at + (
                min(self.interval_s, MAX_URGENT_DELAY_S) if self._pending.urgent else self.interval_s
            )
            if due <= now:
                return self._send_delta()
            self._schedule(due)
        if self._sent_at + HEARTBEAT_AFTER_S <= now:
            self._offer(self._message("delta", {}, {}))
        return None

    @property
    def _has_pending(self) -> bool:
        return bool(self._pending.topics)

    def _add(self, change: TopicChange) -> None:
        """Join what is wanted of it to what is pending."""
        pending, wanted = self._pending, {topic for topic in change.topics if self.matches(topic)}
        pending.urgent |= change.urgent & wanted
        for topic in wanted & change.keys.keys():
            pending.removed.discard(topic)
            pending.keys.setdefault(topic, set()).update(change.keys[topic])
            pending.signals.setdefault(topic, set()).update(change.signals.get(topic, ()))
        for topic in wanted & change.items.keys():
            items = pending.items[topic] = [*pending.items.get(topic, ()), *change.items[topic]]
            pending.drop(topic, len(items) - MAX_CACHED_ITEMS)
            del items[:-MAX_CACHED_ITEMS]
        for topic in wanted & change.missed.keys():
            pending.drop(topic, change.missed[topic])
        for topic in wanted & change.removed:
            pending.keys.pop(topic, None)
            pending.items.pop(topic, None)
            pending.removed.add(topic)

    def _schedule(self, due: float) -> None:
        if self._timer is None or self._timer.when() > due:
            self.cancel_timer()
            self._timer = asyncio.get_running_loop().call_at(due, self._send_delta)

    def _send_delta(self) -> None:
        self.cancel_timer()
        self._delta_sent_at = asyncio.get_running_loop().time()
        self._offer(self._delta())

    def _offer(self, text: str) -> None:
        for ear in tuple(self.subscribers):
            ear.offer(text)

    def _delta(self) -> str:
        pending, self._pending = self._pending, TopicChange()
        now = asyncio.get_running_loop().time()
        topics: Json = {
            topic: self._cache.topic_part(topic, keys, pending.signals.get(topic, set()), now)
            for topic, keys in pending.keys.items()
        }
        topics |= pending.items
        more: Json = {"gone": sorted(pending.removed)} if pending.removed else {}
        more |= {"dropped": pending.missed} if pending.missed else {}
        return self._message("delta", topics, more)

    def _snapshot(self) -> str:
        now, mirror = asyncio.get_running_loop().time(), self._cache
        known = [topic for topic in (*mirror.contents, *mirror.lists) if self.matches(topic)]
        return self._message("snapshot", {topic: mirror.topic(topic, now) for topic in known}, {})

    def _message(self, kind: str, topics: Json, more: Json) -> str:
        if kind == "delta":
            self._seq += 1
            self._sent_at = asyncio.get_running_loop().time()
        return encode_message({"type": kind, "seq": self._seq, "time_ms": self._wall_ms(), "topics": topics} | more)


EARLY_TOLERANCE_S = 0.01
"""The plant's own beat is as long as the usual interval: a message that comes a hair early is not held back for it."""
