"""Fan-out of the live cache: clients with the same topics and interval share one message, which is encoded once."""

from __future__ import annotations

import asyncio
import json
import math
from typing import Any

from drivebus.gateways.cache import TopicCache, TopicChange
from drivebus.types import Json

Patterns = tuple[str, ...]
MAX_URGENT_DELAY_S = 0.25  # changes of state, quality and alarms never wait longer for a client's interval
HEARTBEAT_AFTER_S = 0.7
"""After this time without a message the next one of the service is passed on, empty or not. The service sends at least
one a second, so a client gets one at least every 1.7 s. The page takes 2 s without any for a lost connection."""
MAX_QUEUED_MESSAGES = 32  # a client that leaves more unread (8 s at four a second) is closed as slow


def matches_topic(topic: str, pattern: str) -> bool:
    """Return whether a pattern, in which a star stands for any characters, is that of a topic.

    It takes the time of a search: ``fnmatch`` compiles each pattern, which clients can invent, for a millisecond.
    """
    first, *parts = pattern.split("*")
    if not parts:
        return topic == pattern
    last, at = parts.pop(), len(first)
    if not topic.startswith(first):
        return False
    for part in parts:
        index = topic.find(part, at)
        if index < 0:
            return False
        at = index + len(part)
    return len(topic) - len(last) >= at and topic.endswith(last)


class Subscriber:
    """A client of the cache: its bounded queue of messages and the reason for its end."""

    def __init__(self) -> None:
        self._queue: asyncio.Queue[str] = asyncio.Queue(MAX_QUEUED_MESSAGES)
        self.reason: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        """Its result, a text, is set when the subscriber has to go."""

    def offer(self, text: str) -> None:
        """Queue a message, or close a client that does not take them. Never waits."""
        if self._queue.full():
            self.close("slow")
        else:
            self._queue.put_nowait(text)

    def close(self, reason: str) -> None:
        """End the subscription. Only the first reason counts."""
        if not self.reason.done():
            self.reason.set_result(reason)

    async def next(self) -> str:
        """Return the next message."""
        return await self._queue.get()


def encode_message(message: Json) -> str:
    """Return a message as JSON on one line."""
    return json.dumps(message, ensure_ascii=False, separators=(",", ":"))


class FanoutGroup:
    """Subscribers of the same patterns at the same interval; made by ``UpstreamFeed`` for the first of them."""

    def __init__(self, cache: TopicCache, patterns: Patterns, interval_s: float) -> None:
        self._cache, self.patterns, self.interval_s = cache, patterns, interval_s
        self.subscribers: set[Subscriber] = set()
        self._seq = 0
        self._sent_at = self._delta_sent_at = -math.inf
        """When any message, and when the last delta with content, was sent."""
        self._timer: asyncio.TimerHandle | None = None
        self._matches: dict[str, bool] = {}
        self._pending = TopicChange()

    def matches(self, topic: str) -> bool:
        is_match = self._matches.get(topic)
        if is_match is None:
            is_match = self._matches[topic] = any(matches_topic(topic, pattern) for pattern in self.patterns)
        return is_match

    def join(self, subscriber: Subscriber, *, send_snapshot: bool) -> None:
        """Add a subscriber. What is pending goes to the others first, so that its snapshot is where all of them are.

        Without ``send_snapshot`` the service has not begun; the snapshot comes with ``restart``.
        """
        if send_snapshot and self._pending.topics:
            self._send_delta()
        self.subscribers.add(subscriber)
        if send_snapshot:
            subscriber.offer(self._snapshot())

    def leave(self, subscriber: Subscriber) -> None:
        self.subscribers.discard(subscriber)
        if not self.subscribers:
            self.cancel_timer()

    def restart(self) -> None:
        """Send every subscriber a snapshot: the service has started over."""
        self.cancel_timer()
        self._pending = TopicChange()
        self._sent_at = self._delta_sent_at = asyncio.get_running_loop().time()
        self._offer(self._snapshot())

    def cancel_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def on_change(self, change: TopicChange) -> None:
        """Take in the changes of a message of the service; send them now, or when the interval is over.

        Only the service's messages make this group send: where the service is silent there is no heartbeat either.
        """
        self._pending.add(change, [topic for topic in change.topics if self.matches(topic)])
        now = asyncio.get_running_loop().time()
        if self._pending.topics:
            interval_s = min(self.interval_s, MAX_URGENT_DELAY_S) if self._pending.urgent else self.interval_s
            due = self._delta_sent_at + interval_s
            if due <= now:
                self._send_delta()
                return
            self._schedule(due)
        if self._sent_at + HEARTBEAT_AFTER_S <= now:
            self._offer(self._message("delta", {}))

    def _schedule(self, due: float) -> None:
        if self._timer is None or self._timer.when() > due:
            self.cancel_timer()
            self._timer = asyncio.get_running_loop().call_at(due, self._send_delta)

    def _offer(self, text: str) -> None:
        for subscriber in tuple(self.subscribers):
            subscriber.offer(text)

    def _send_delta(self) -> None:
        self.cancel_timer()
        pending, self._pending = self._pending, TopicChange()
        self._delta_sent_at = asyncio.get_running_loop().time()
        topics: Json = {
            topic: self._cache.part(topic, keys, pending.signals.get(topic, set()))
            for topic, keys in pending.keys.items()
        }
        more: Json = {"removed": sorted(pending.removed)} if pending.removed else {}
        more |= {"missed": pending.missed} if pending.missed else {}
        self._offer(self._message("delta", topics | pending.items, **more))

    def _snapshot(self) -> str:
        topics = [topic for topic in (*self._cache.topics, *self._cache.lists) if self.matches(topic)]
        return self._message("snapshot", {topic: self._cache.content(topic) for topic in topics})

    def _message(self, kind: str, topics: Json, **more: Json) -> str:
        now = asyncio.get_running_loop().time()
        if kind == "delta":
            self._seq += 1
            self._sent_at = now
        return encode_message(
            {"type": kind, "seq": self._seq, "time_ms": self._cache.now_ms(now), "topics": topics} | more
        )
