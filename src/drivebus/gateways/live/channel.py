"""All clients that want the same topics at the same rate: what they are told is put together and encoded once."""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import Callable
from fnmatch import fnmatchcase
from typing import Any, Protocol

from drivebus.gateways.live.mirror import KEPT, Change, Mirror

Json = dict[str, Any]

URGENT_S = 0.25
"""However seldom a client wants values: changes of state, trust and alarms come this soon (G17)."""
HEARTBEAT_S = 0.7
"""After so long in silence the next message of the plant is told on, empty or not. The plant speaks every second at
least, clients hear something every 1.7 s at most: twice that is a lost line."""


class Ear(Protocol):
    """One client, as a channel sees it."""

    def offer(self, text: str) -> None:
        """Take a message, or be closed for not taking them; never waits."""
        ...

    def close(self, reason: str) -> None:
        """No more comes: tell why. Never waits."""
        ...


def encoded(message: Json) -> str:
    return json.dumps(message, ensure_ascii=False, separators=(",", ":"))


class Channel:
    """Made by ``Feed`` for its first client. ``wall_ms`` labels messages; times are of the loop's clock."""

    def __init__(
        self, mirror: Mirror, patterns: tuple[str, ...], interval_s: float, wall_ms: Callable[[], int]
    ) -> None:
        self._mirror, self.patterns, self.interval_s, self._wall_ms = mirror, patterns, interval_s, wall_ms
        self.ears: set[Ear] = set()
        self._seq = 0
        self._sent_at = self._told_at = -math.inf
        """When anything, and when anything new, was told."""
        self._timer: asyncio.TimerHandle | None = None
        self._wants: dict[str, bool] = {}
        self._pending = Change()

    def wants(self, topic: str) -> bool:
        found = self._wants.get(topic)
        if found is None:
            found = self._wants[topic] = any(fnmatchcase(topic, pattern) for pattern in self.patterns)
        return found

    def join(self, ear: Ear, *, tell: bool) -> None:
        """Everybody else is told what is pending first, so that the snapshot is where all of them are.

        ``tell`` False: the plant has not begun; the snapshot comes with ``begin_anew``.
        """
        if tell and self._has_pending:
            self._tell()
        self.ears.add(ear)
        if tell:
            ear.offer(self._snapshot())

    def leave(self, ear: Ear) -> None:
        self.ears.discard(ear)
        if not self.ears:
            self.end()

    def begin_anew(self) -> None:
        """The plant began anew: so does everybody."""
        self.end()
        self._pending = Change()
        self._sent_at = self._told_at = asyncio.get_running_loop().time()
        self._offer(self._snapshot())

    def end(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def heard(self, change: Change) -> None:
        """A message of the plant: nothing else makes this channel speak, so where the plant falls silent there is no
        heartbeat either.
        """
        self._add(change)
        now = asyncio.get_running_loop().time() + _EARLY_S
        if self._has_pending:
            due = self._told_at + (min(self.interval_s, URGENT_S) if self._pending.urgent else self.interval_s)
            if due <= now:
                return self._tell()
            self._wake_at(due)
        if self._sent_at + HEARTBEAT_S <= now:
            self._offer(self._message("delta", {}, {}))
        return None

    @property
    def _has_pending(self) -> bool:
        return bool(self._pending.topics)

    def _add(self, change: Change) -> None:
        """Join what is wanted of it to what is pending."""
        pending, wanted = self._pending, {topic for topic in change.topics if self.wants(topic)}
        pending.urgent |= change.urgent & wanted
        for topic in wanted & change.keys.keys():
            pending.gone.discard(topic)
            pending.keys.setdefault(topic, set()).update(change.keys[topic])
            pending.signals.setdefault(topic, set()).update(change.signals.get(topic, ()))
        for topic in wanted & change.items.keys():
            items = pending.items[topic] = [*pending.items.get(topic, ()), *change.items[topic]]
            pending.drop(topic, len(items) - KEPT)
            del items[:-KEPT]
        for topic in wanted & change.dropped.keys():
            pending.drop(topic, change.dropped[topic])
        for topic in wanted & change.gone:
            pending.keys.pop(topic, None)
            pending.items.pop(topic, None)
            pending.gone.add(topic)

    def _wake_at(self, due: float) -> None:
        if self._timer is None or self._timer.when() > due:
            self.end()
            self._timer = asyncio.get_running_loop().call_at(due, self._tell)

    def _tell(self) -> None:
        self.end()
        self._told_at = asyncio.get_running_loop().time()
        self._offer(self._delta())

    def _offer(self, text: str) -> None:
        for ear in tuple(self.ears):
            ear.offer(text)

    def _delta(self) -> str:
        pending, self._pending = self._pending, Change()
        now = asyncio.get_running_loop().time()
        topics: Json = {
            topic: self._mirror.part(topic, keys, pending.signals.get(topic, set()), now)
            for topic, keys in pending.keys.items()
        }
        topics |= pending.items
        more: Json = {"gone": sorted(pending.gone)} if pending.gone else {}
        more |= {"dropped": pending.dropped} if pending.dropped else {}
        return self._message("delta", topics, more)

    def _snapshot(self) -> str:
        now, mirror = asyncio.get_running_loop().time(), self._mirror
        known = [topic for topic in (*mirror.contents, *mirror.lists) if self.wants(topic)]
        return self._message("snapshot", {topic: mirror.topic(topic, now) for topic in known}, {})

    def _message(self, kind: str, topics: Json, more: Json) -> str:
        if kind == "delta":
            self._seq += 1
            self._sent_at = asyncio.get_running_loop().time()
        return encoded({"type": kind, "seq": self._seq, "time_ms": self._wall_ms(), "topics": topics} | more)


_EARLY_S = 0.01
"""The plant's own beat is as long as the usual interval: a message that comes a hair early is not held back for it."""
