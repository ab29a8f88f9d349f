"""Cache of the service's live topics: whole objects in, snapshots and changes out.

Every gateway uses it. It holds no ages: objects carry absolute times on the service's clock, which ``now_ms`` returns.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from drivebus.service.live.hub import MAX_LIST_ITEMS
from drivebus.types import Json

_ROUTINE_KEYS = frozenset({"signals", "state_time_ms"})
"""Keys of a drive that change with every reply."""
_BUS_STATE_KEYS = frozenset({"is_open", "foreign_master"})
"""Keys of a bus that are no figures, which change all the time."""
_MISSING: Any = object()


@dataclass(slots=True, kw_only=True)
class TopicChange:
    """Changes of one or several messages of the service."""

    keys: dict[str, set[str]] = field(default_factory=dict)
    """Topic → top-level keys."""
    signals: dict[str, set[str]] = field(default_factory=dict)
    """Topic → names of its signals."""
    items: dict[str, list[Json]] = field(default_factory=dict)
    """List topic → new items."""
    missed: dict[str, int] = field(default_factory=dict)
    """List topic → items that were dropped on the way."""
    removed: set[str] = field(default_factory=set)
    urgent: set[str] = field(default_factory=set)
    """Topics of which more changed than values of the same quality; sent without waiting for a client's interval."""

    @property
    def topics(self) -> set[str]:
        return self.keys.keys() | self.items.keys() | self.missed.keys() | self.removed

    def add(self, other: TopicChange, topics: Iterable[str]) -> None:
        """Merge the changes of some topics into this one."""
        for topic in topics:
            if topic in other.urgent:
                self.urgent.add(topic)
            if topic in other.keys:
                self.removed.discard(topic)
                self.keys.setdefault(topic, set()).update(other.keys[topic])
                self.signals.setdefault(topic, set()).update(other.signals.get(topic, ()))
            if topic in other.items:
                self.removed.discard(topic)
                items = self.items[topic] = [*self.items.get(topic, ()), *other.items[topic]]
                self._count_missed(topic, len(items) - MAX_LIST_ITEMS)
                del items[:-MAX_LIST_ITEMS]
            self._count_missed(topic, other.missed.get(topic, 0))
            if topic in other.removed:
                self.keys.pop(topic, None)
                self.signals.pop(topic, None)
                self.items.pop(topic, None)
                self.removed.add(topic)

    def _count_missed(self, topic: str, count: int) -> None:
        if count > 0:
            self.missed[topic] = self.missed.get(topic, 0) + count


class TopicCache:
    """Topics and lists. Pure: monotonic seconds are arguments."""

    def __init__(self) -> None:
        self.topics: dict[str, Json] = {}
        self.lists: dict[str, deque[Json]] = {}
        self._clock_ms = 0
        self._received_at = 0.0

    def apply(self, message: Json, now: float) -> TopicChange:
        """Take in a ``snapshot`` or ``update`` of the service and return what it changed."""
        self._clock_ms, self._received_at = message["time_ms"], now
        change = TopicChange(missed=dict(message.get("missed", {})))
        for topic, content in message["topics"].items():
            if isinstance(content, list):
                self._append(topic, content, change)
            else:
                self._replace(topic, content, change)
        for topic in message.get("removed", ()):
            self.remove(topic)
            change.removed.add(topic)
            change.urgent.add(topic)
        return change

    def now_ms(self, now: float) -> int:
        """Return the service's time: the one of its last message and the time since."""
        return self._clock_ms + round((now - self._received_at) * 1000)

    def silence_s(self, now: float) -> float:
        """Return the time since the service's last message."""
        return now - self._received_at

    def clear(self) -> None:
        """Discard everything: the service starts over."""
        self.topics.clear()
        self.lists.clear()

    def remove(self, topic: str) -> None:
        self.topics.pop(topic, None)
        self.lists.pop(topic, None)

    def content(self, topic: str) -> Json | list[Json]:
        """Return a whole topic. Raises KeyError."""
        return list(self.lists[topic]) if topic in self.lists else self.topics[topic]

    def part(self, topic: str, keys: set[str], signals: set[str]) -> Json:
        """Return some keys of a topic, and of ``signals`` only those named; null for one that is gone."""
        content = self.topics[topic]
        part = {key: content[key] for key in content if key in keys}
        if "signals" in part:
            part["signals"] = {name: content["signals"].get(name) for name in sorted(signals)}
        return part

    def _append(self, topic: str, items: list[Json], change: TopicChange) -> None:
        """Append new items. Frames are numbered: those of a new snapshot that are known already are left out."""
        cached = self.lists.setdefault(topic, deque(maxlen=MAX_LIST_ITEMS))
        newest = cached[-1].get("n", 0) if cached else 0
        fresh = [item for item in items if item.get("n", newest + 1) > newest]
        cached.extend(fresh)
        change.items[topic] = fresh
        if topic == "events":
            change.urgent.add(topic)

    def _replace(self, topic: str, content: Json, change: TopicChange) -> None:
        before = self.topics.get(topic, {})
        self.topics[topic] = content
        keys = {key for key, value in content.items() if before.get(key, _MISSING) != value}
        if not keys:
            return
        change.keys[topic] = keys
        if "signals" in keys:
            self._replace_signals(topic, before.get("signals", {}), content["signals"], change)
        if keys & _BUS_STATE_KEYS if topic.startswith("buses/") else keys - _ROUTINE_KEYS:
            change.urgent.add(topic)

    def _replace_signals(self, topic: str, previous: Json, signals: Json, change: TopicChange) -> None:
        absent = previous.keys() - signals.keys()  # of a drive that a reload has replaced by another model
        changed = {name for name, value in signals.items() if previous.get(name, _MISSING) != value}
        change.signals[topic] = changed | absent
        if absent or any(
            name not in previous or previous[name]["quality"] != signals[name]["quality"] for name in changed
        ):
            change.urgent.add(topic)
