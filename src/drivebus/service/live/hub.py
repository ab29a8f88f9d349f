"""Hub of live values: the newest whole object of every topic, pushed to its subscribers when it changes.

The service has no patterns, deltas or queues: a subscriber that is busy gets everything that changed meanwhile in its
next message, and of each topic only the newest. Snapshots, deltas and filters for clients are made by the gateways.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncIterator, Callable

from drivebus.service.api.errors import localized
from drivebus.service.runtime.fairness import iter_cooperatively
from drivebus.types import Json

STATE_STREAM = "state"
"""The stream of every topic but frames."""
FRAMES_PREFIX = "frames/"
"""Prefix of the streams of frames, one for each bus: frames are decoded only for a subscriber."""
MAX_LIST_ITEMS = 500  # newest items of a list (events, frames) in a snapshot, also of a gateway's cache
HEARTBEAT_S = 1.0  # a stream without changes sends an empty update this often

ListItem = Json | Callable[[], Json]
"""An item, or the function that makes it when it is sent: decoding a frame takes time."""


class Hub:
    """Topics and their subscribers. Belongs to one loop; nothing here waits for a subscriber."""

    def __init__(self, now_ms: Callable[[], int]) -> None:
        """``now_ms``: UTC milliseconds on the clock of the times in the topics."""
        self._now_ms = now_ms
        self.topics: dict[str, Json] = {}
        self._lists: dict[str, deque[tuple[int, ListItem]]] = {}
        self._last_numbers: dict[str, int] = {}
        self._subscribers: set[_Subscriber] = set()
        self._is_closed = False

    def publish(self, topic: str, content: Json) -> None:
        """Replace a topic; subscribers are notified only where it differs. ``content`` must not be changed later."""
        if self.topics.get(topic) == content:
            return
        self.topics[topic] = content
        for subscriber in self._subscribers_of(topic):
            subscriber.mark_changed(topic)

    def append(self, topic: str, item: ListItem) -> int:
        """Add an item to a list topic; return its number, counted from 1."""
        number = self._last_numbers[topic] = self._last_numbers.get(topic, 0) + 1
        self._lists.setdefault(topic, deque(maxlen=MAX_LIST_ITEMS)).append((number, item))
        for subscriber in self._subscribers_of(topic):
            subscriber.wakeup.set()
        return number

    def remove(self, topic: str) -> None:
        """Remove a topic or list."""
        if self.topics.pop(topic, None) is not None or self._lists.pop(topic, None) is not None:
            for subscriber in self._subscribers_of(topic):
                subscriber.mark_removed(topic)

    def items(self, topic: str, after: int = 0) -> list[tuple[int, ListItem]]:
        """Return the kept items of a list with numbers above ``after``."""
        return [(number, item) for number, item in self._lists.get(topic, ()) if number > after]

    @property
    def subscriber_count(self) -> int:
        return len(self._subscribers)

    def has_subscriber(self, topic: str) -> bool:
        return any(True for _ in self._subscribers_of(topic))

    def _subscribers_of(self, topic: str) -> list[_Subscriber]:
        stream = topic if topic.startswith(FRAMES_PREFIX) else STATE_STREAM
        return [subscriber for subscriber in self._subscribers if subscriber.stream == stream]

    async def subscribe(self, stream: str) -> AsyncIterator[Json]:
        """Yield the messages of one stream; see ``ServiceClient.live``."""
        subscriber = _Subscriber(stream)
        self._subscribers.add(subscriber)
        try:
            yield await self._snapshot(subscriber)
            while not self._is_closed:
                await subscriber.wait(HEARTBEAT_S)
                if not self._is_closed:
                    yield await self._update(subscriber)
            yield closed_message("shutdown")
        finally:
            self._subscribers.discard(subscriber)

    def close(self) -> None:
        """End every stream with the reason ``shutdown``."""
        self._is_closed = True
        for subscriber in self._subscribers:
            subscriber.wakeup.set()

    async def _snapshot(self, subscriber: _Subscriber) -> Json:
        topics: Json = {}
        if subscriber.stream == STATE_STREAM:
            topics.update(self.topics)
        items, _ = await self._new_items(subscriber)
        return self._message("snapshot", topics | items)

    async def _update(self, subscriber: _Subscriber) -> Json:
        changed, removed = subscriber.take()
        items, missed = await self._new_items(subscriber)
        topics = {topic: self.topics[topic] for topic in changed if topic in self.topics}
        message = self._message("update", topics | items)
        message |= {"removed": removed} if removed else {}
        return message | ({"missed": missed} if missed else {})

    async def _new_items(self, subscriber: _Subscriber) -> tuple[dict[str, list[Json]], dict[str, int]]:
        """Return the items of each list that were not sent yet, and how many were dropped before they could be."""
        items_by_topic: dict[str, list[Json]] = {}
        missed: dict[str, int] = {}
        for topic, last in tuple(self._last_numbers.items()):
            sent = subscriber.sent_numbers.get(topic)
            if sent == last or subscriber not in self._subscribers_of(topic):
                continue
            subscriber.sent_numbers[topic] = last
            if topic not in self._lists:
                continue
            items = [item for number, item in self.items(topic, sent or 0) if number <= last]
            items_by_topic[topic] = [
                item() if callable(item) else item async for item in iter_cooperatively(items, internal=True)
            ]
            if sent is not None and (dropped := last - sent - len(items)):
                missed[topic] = dropped
        return items_by_topic, missed

    def _message(self, kind: str, topics: Json) -> Json:
        return {"type": kind, "time_ms": self._now_ms(), "topics": topics}


class _Subscriber:
    """Receiver of one stream: the topics that changed since its last message."""

    def __init__(self, stream: str) -> None:
        self.stream = stream
        self.wakeup = asyncio.Event()
        self.sent_numbers: dict[str, int] = {}
        """List topic → number of the newest item that was sent."""
        self._changed: dict[str, None] = {}
        self._removed: set[str] = set()

    def mark_changed(self, topic: str) -> None:
        self._removed.discard(topic)
        self._changed[topic] = None
        self.wakeup.set()

    def mark_removed(self, topic: str) -> None:
        self._changed.pop(topic, None)
        self._removed.add(topic)
        self.wakeup.set()

    def take(self) -> tuple[list[str], list[str]]:
        """Return and clear the changed and removed topics."""
        changed, removed = [*self._changed], sorted(self._removed)
        self._changed, self._removed = {}, set()
        return changed, removed

    async def wait(self, timeout_s: float) -> None:
        """Return when something changed, or after the timeout."""
        try:
            async with asyncio.timeout(timeout_s):
                await self.wakeup.wait()
        except TimeoutError:
            pass
        self.wakeup.clear()


def closed_message(reason: str) -> Json:
    """Return the last message of a stream."""
    return {"type": "closed", "reason": reason, "text": localized(f"plant.closed_{reason}")}
