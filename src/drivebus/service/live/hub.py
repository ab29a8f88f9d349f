"""The hub: the newest of everything by topic, told to whoever listens as a snapshot and then as what changed.

A listener gets at most one message per interval, with everything that changed since coalesced; one that does not take
its messages is closed with the reason, so that it can't hold up or fill anything (I12).
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from typing import Any

from drivebus.service.live.subscription import HubSubscription
from drivebus.service.live.topics import value_json

Json = dict[str, Any]
MAX_LIST_ITEMS = 500
"""So many items of a list (frames, events) are kept for who looks later."""


class Hub:
    """Topics and listeners. Belongs to one loop; nothing here waits for a listener."""

    def __init__(self, now: Callable[[], float], wall_ms: Callable[[], int]) -> None:
        self.now, self.wall_ms = now, wall_ms
        self.contents: dict[str, Json] = {}
        """Topic → key → value; the key ``signals`` holds one more level."""
        self.lists: dict[str, deque[tuple[int, Any]]] = {}
        self._numbers: dict[str, int] = {}
        self._listeners: set[HubSubscription] = set()

    def publish(self, topic: str, content: Mapping[str, Any]) -> None:
        """This is how it is now; only what differs from before is told."""
        before = self.contents.get(topic)
        self.contents[topic] = now = dict(content)
        changed = set(now) if before is None else {key for key in now if now[key] != before.get(key, _NOTHING)}
        if not changed:
            return
        signals: set[str] = set()
        if before is not None and "signals" in changed and "signals" in before:
            old, new = before["signals"], now["signals"]
            signals = {name for name in new if new[name] != old.get(name, _NOTHING)}
        for listener in self._listeners:
            listener.on_changed(topic, changed, signals)

    def append(self, topic: str, item: Any) -> int:
        """One more item of a list; returns its number, which counts from 1."""
        number = self._numbers[topic] = self._numbers.get(topic, 0) + 1
        self.lists.setdefault(topic, deque(maxlen=MAX_LIST_ITEMS)).append((number, item))
        for listener in self._listeners:
            listener.on_appended(topic, number)
        return number

    def remove(self, topic: str) -> None:
        """It is gone."""
        if self.contents.pop(topic, None) is not None or self.lists.pop(topic, None) is not None:
            for listener in self._listeners:
                listener.on_removed(topic)

    def topic(self, topic: str) -> Json:
        """A topic as it is told now. Raises KeyError."""
        return self.topic_part(topic, set(self.contents[topic]), None)

    def topic_part(self, topic: str, keys: set[str], signals: set[str] | None) -> Json:
        """Some keys of a topic; of ``signals`` only those named, all where None."""
        now, content = self.now(), self.contents[topic]
        found = {key: value_json(content[key], now) for key in keys if key != "signals" and key in content}
        if "signals" in keys and "signals" in content:
            chosen = content["signals"]
            found["signals"] = {
                name: value_json(value, now) for name, value in chosen.items() if signals is None or name in signals
            }
        return found

    def items(self, topic: str, after: int = 0) -> list[tuple[int, Any]]:
        """What is kept of a list, with numbers above ``after``."""
        return [(number, item) for number, item in self.lists.get(topic, ()) if number > after]

    def last_number(self, topic: str) -> int:
        """The number of a list's newest item, 0 where there was none."""
        return self._numbers.get(topic, 0)

    async def live(self, patterns: Sequence[str], interval_s: float = 0.25) -> AsyncIterator[Json]:
        """Messages for one listener until it or the hub ends; see ``ServiceClient.live``."""
        listener = HubSubscription(self, patterns, interval_s)
        self._listeners.add(listener)
        try:
            async for message in listener.messages():
                yield message
        finally:
            self._listeners.discard(listener)
            listener.end()

    @property
    def listeners(self) -> int:
        """How many listen now."""
        return len(self._listeners)

    def has_listener(self, topic: str) -> bool:
        """Does anybody listen to it?"""
        return any(listener.wants(topic) for listener in self._listeners)

    async def close(self) -> None:
        """Tell every listener that the plant ends."""
        for listener in tuple(self._listeners):
            listener.close("shutdown")
        await asyncio.sleep(0)


_NOTHING = object()
