"""What the plant told, as it is now: whole topics for a newcomer's snapshot, changed parts for everybody else.

Ages and remaining times go on while a message waits here, so that nothing looks younger than it is (G17).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any

Json = dict[str, Any]

MAX_CACHED_ITEMS = 500
"""So many items of a list are kept for newcomers, as the plant itself does."""
AGE_TOLERANCE_S = 0.05
"""Ages that are off by less are left as they came: it saves a copy of every value."""

_BUS_STATE_KEYS = frozenset({"is_open", "foreign_master"})
"""What of a bus is no figure that moves all the time."""


@dataclass(slots=True)
class TopicChange:
    """What one message of the plant changed."""

    keys: dict[str, set[str]] = field(default_factory=dict)
    """Topic → top-level keys."""
    signals: dict[str, set[str]] = field(default_factory=dict)
    items: dict[str, list[Any]] = field(default_factory=dict)
    missed: dict[str, int] = field(default_factory=dict)
    removed: set[str] = field(default_factory=set)
    urgent: set[str] = field(default_factory=set)
    """Topics of which more changed than values of the same trust: nobody's interval holds that back."""

    @property
    def topics(self) -> set[str]:
        return self.keys.keys() | self.items.keys() | self.missed.keys() | self.removed

    def drop(self, topic: str, count: int) -> None:
        """So many items more were left out."""
        if count > 0:
            self.missed[topic] = self.missed.get(topic, 0) + count


@dataclass(frozen=True, slots=True)
class AgeingEntry:
    """A value with seconds in it, and when it was heard."""

    value: Json
    at: float

    def json(self, now: float) -> Json:
        held_s = now - self.at
        if held_s < AGE_TOLERANCE_S:
            return self.value
        value = self.value
        if value.get("age_s") is not None:
            value = value | {"age_s": round(value["age_s"] + held_s, 3)}
        if value.get("expires_in_s") is not None:
            value = value | {"expires_in_s": round(max(0.0, value["expires_in_s"] - held_s), 1)}
        return value


class TopicCache:
    """Topics and lists. Pure: time is an argument (monotonic seconds)."""

    def __init__(self) -> None:
        self.contents: dict[str, Json] = {}
        self.lists: dict[str, deque[Any]] = {}

    def apply(self, message: Json, now: float) -> TopicChange:
        """A snapshot or delta of the plant."""
        change = TopicChange(missed=dict(message.get("dropped", {})))
        for topic, told in message["topics"].items():
            if isinstance(told, list):
                self._append(topic, told, change)
            else:
                self._merge(topic, told, now, change)
        for topic in message.get("gone", ()):
            self.remove(topic)
            change.removed.add(topic)
            change.urgent.add(topic)
        return change

    def clear(self) -> None:
        """The plant begins anew."""
        self.contents.clear()
        self.lists.clear()

    def remove(self, topic: str) -> None:
        self.contents.pop(topic, None)
        self.lists.pop(topic, None)

    def topic(self, topic: str, now: float) -> Any:
        """The whole of it. Raises KeyError."""
        if topic in self.lists:
            return list(self.lists[topic])
        return self.topic_part(topic, set(self.contents[topic]), None, now)

    def topic_part(self, topic: str, keys: set[str], signals: set[str] | None, now: float) -> Json:
        """Some keys of a topic; of ``signals`` only those named, all where None."""
        content = self.contents[topic]
        found = {key: _value_json(content[key], now) for key in content if key in keys and key != "signals"}
        if "signals" in keys:
            wanted = content["signals"]
            found["signals"] = {name: wanted[name].json(now) for name in wanted if signals is None or name in signals}
        return found

    def _append(self, topic: str, items: list[Any], change: TopicChange) -> None:
        kept = self.lists.setdefault(topic, deque(maxlen=MAX_CACHED_ITEMS))
        newest = kept[-1].get("n", 0) if kept else 0
        fresh = [item for item in items if item.get("n", newest + 1) > newest]
        kept.extend(fresh)
        change.items[topic] = fresh
        if topic == "events":
            change.urgent.add(topic)

    def _merge(self, topic: str, told: Json, now: float, change: TopicChange) -> None:
        content = self.contents.setdefault(topic, {})
        change.keys[topic] = set(told)
        for key, value in told.items():
            if key == "signals":
                self._signals(topic, content.setdefault("signals", {}), value, now, change)
            else:
                content[key] = AgeingEntry(value, now) if key == "lease" and value is not None else value
        if set(told) & _BUS_STATE_KEYS if topic.startswith("buses/") else set(told) - {"signals"}:
            change.urgent.add(topic)

    def _signals(self, topic: str, content: Json, told: Json, now: float, change: TopicChange) -> None:
        change.signals[topic] = set(told)
        for name, value in told.items():
            before = content.get(name)
            if before is None or before.value["quality"] != value["quality"]:
                change.urgent.add(topic)
            content[name] = AgeingEntry(value, now)


def _value_json(value: Any, now: float) -> Any:
    return value.json(now) if isinstance(value, AgeingEntry) else value
