"""One listener of the hub: what it wants, what it has not been told yet, and its bounded queue of messages."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Sequence
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any

from drivebus.service.live.topics import closed_message, value_json
from drivebus.service.runtime.fairness import iter_cooperatively

if TYPE_CHECKING:
    from drivebus.service.live.hub import Hub

Json = dict[str, Any]
HUB_HEARTBEAT_S = 1.0
MAX_QUEUED_HUB_MESSAGES = 32
"""A listener that leaves so many messages lying (8 s at the usual four a second) is closed."""
MAX_BURST_ITEMS = 500
"""So many items of one list in one message; of more the oldest are dropped, and said so."""


class HubSubscription:
    """Made and ended by ``Hub.live``."""

    def __init__(self, hub: Hub, patterns: Sequence[str], interval_s: float) -> None:
        self._hub, self._patterns, self._interval_s = hub, tuple(patterns), interval_s
        self._queue: asyncio.Queue[Json] = asyncio.Queue(MAX_QUEUED_HUB_MESSAGES)
        self._changed: dict[str, tuple[set[str], set[str]]] = {}
        self._lists: dict[str, int] = {}
        self._gone: set[str] = set()
        self._seq = 0
        self._matches: dict[str, bool] = {}
        self._task: asyncio.Task[None] | None = None
        self._is_closed = False

    def wants(self, topic: str) -> bool:
        found = self._matches.get(topic)
        if found is None:
            found = self._matches[topic] = any(fnmatchcase(topic, pattern) for pattern in self._patterns)
        return found

    def on_changed(self, topic: str, keys: set[str], signals: set[str]) -> None:
        """These keys of a topic differ now. ``signals``: which of them, all where empty and the key is named."""
        if not self.wants(topic):
            return
        self._gone.discard(topic)
        known = self._changed.setdefault(topic, (set(), set()))
        if "signals" in keys and not signals:
            known[1].update(self._hub.contents[topic]["signals"])
        known[0].update(keys)
        known[1].update(signals)

    def on_appended(self, topic: str, number: int) -> None:
        if self.wants(topic):
            self._lists.setdefault(topic, number - 1)

    def on_removed(self, topic: str) -> None:
        self._changed.pop(topic, None)
        self._lists.pop(topic, None)
        if self.wants(topic):
            self._gone.add(topic)

    async def messages(self) -> AsyncIterator[Json]:
        """The snapshot, deltas, and the reason of the end."""
        self._put(await self._snapshot())
        self._task = asyncio.create_task(self._send_deltas(), name="live")
        while True:
            message = await self._queue.get()
            yield message
            if message["type"] == "closed":
                return

    def close(self, reason: str) -> None:
        """What it has not taken is dropped: the last thing it hears is why."""
        if self._is_closed:
            return
        self._is_closed = True
        while not self._queue.empty():
            self._queue.get_nowait()
        self._queue.put_nowait(closed_message(reason))
        self.end()

    def end(self) -> None:
        if self._task is not None and self._task is not _current():
            self._task.cancel()

    async def _send_deltas(self) -> None:
        quiet_s = 0.0
        while not self._is_closed:
            await asyncio.sleep(self._interval_s)
            quiet_s += self._interval_s
            if self._changed or self._lists or self._gone or quiet_s >= HUB_HEARTBEAT_S - 1e-9:
                quiet_s = 0.0
                self._put(await self._delta())

    def _put(self, message: Json) -> None:
        if self._is_closed:
            return
        if self._queue.full():
            self.close("slow")
        else:
            self._queue.put_nowait(message)

    def _message(self, kind: str, topics: Json) -> Json:
        self._seq += 1
        return {"type": kind, "seq": self._seq, "time_ms": self._hub.wall_ms(), "topics": topics}

    async def _snapshot(self) -> Json:
        """Everything that is wanted; what changes meanwhile is in the first delta too."""
        hub = self._hub
        topics: Json = {}
        async for topic in iter_cooperatively(
            [one for one in (*hub.contents, *hub.lists) if self.wants(one)], internal=True
        ):
            if topic in hub.contents:
                topics[topic] = hub.topic(topic)
            elif topic in hub.lists:
                topics[topic] = _shown(hub, topic, 0)[0]
        return self._message("snapshot", topics)

    async def _delta(self) -> Json:
        hub, changed, lists, gone = self._hub, self._changed, self._lists, self._gone
        self._changed, self._lists, self._gone = {}, {}, set()
        topics: Json = {}
        dropped: dict[str, int] = {}
        async for topic in iter_cooperatively([*changed], internal=True):
            if topic in hub.contents:
                topics[topic] = hub.topic_part(topic, *changed[topic])
        for topic, after in lists.items():
            topics[topic], missing = _shown(hub, topic, after)
            dropped |= {topic: missing} if missing else {}
        message = self._message("delta", topics)
        message |= {"gone": sorted(gone)} if gone else {}
        message |= {"dropped": dropped} if dropped else {}
        return message


def _shown(hub: Hub, topic: str, after: int) -> tuple[list[Any], int]:
    """A list's items after a number, and how many of them are no longer kept."""
    kept = hub.items(topic, after)[-MAX_BURST_ITEMS:]
    now = hub.now()
    missing = hub.last_number(topic) - after - len(kept)
    return [value_json(item, now) for _, item in kept], missing


def _current() -> asyncio.Task[Any] | None:
    try:
        return asyncio.current_task()
    except RuntimeError:
        return None
