"""Fairness on the event loop: long work is split into pieces, one per loop iteration, so that it delays no stop.

Commands never wait for a turn: a stop must not overtake an earlier start, which it has to invalidate.
"""

from __future__ import annotations

import asyncio
import json
from collections import deque
from collections.abc import AsyncIterator, Iterator, Sequence
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

T = TypeVar("T")
ITEMS_PER_TURN = 8  # drives or frames without a pause: one or two milliseconds
MAX_CHUNK_CHARS = 32 * 1024
"""Characters of JSON without a pause: at most a millisecond."""
SPLIT_LEVELS = 3
"""Levels of a message that are split: the message, its content, and its list of drives or frames."""


class _TurnQueue:
    """Waiting tasks of one loop, first come first served; requests and live values take turns."""

    def __init__(self) -> None:
        self._kinds: deque[deque[asyncio.Future[None]]] = deque((deque(), deque()))
        self._queues = dict(zip((False, True), self._kinds, strict=True))

    def wait(self, loop: asyncio.AbstractEventLoop, *, internal: bool) -> asyncio.Future[None]:
        turn = loop.create_future()
        if not any(self._kinds):
            loop.call_soon(self._next, loop)
        self._queues[internal].append(turn)
        return turn

    def _next(self, loop: asyncio.AbstractEventLoop) -> None:
        """Wake the next task; skip cancelled ones."""
        self._kinds.rotate()
        while waiting := self._kinds[0] or self._kinds[1]:
            first = waiting.popleft()
            if not first.done():
                first.set_result(None)
                break
        if any(self._kinds):
            loop.call_soon(self._next, loop)


_QUEUES: WeakKeyDictionary[asyncio.AbstractEventLoop, _TurnQueue] = WeakKeyDictionary()


async def yield_to_loop(*, internal: bool = False) -> None:
    """Wait for a turn: of all tasks that wait on this loop, one continues per iteration.

    ``internal``: live values and incidents, which get every second turn however many requests wait.
    """
    loop = asyncio.get_running_loop()
    if (turns := _QUEUES.get(loop)) is None:
        turns = _QUEUES[loop] = _TurnQueue()
    await turns.wait(loop, internal=internal)


COMPACT_ENCODER = json.JSONEncoder(ensure_ascii=False, separators=(",", ":"), allow_nan=False)


async def iter_cooperatively(
    items: Sequence[T], at_once: int = ITEMS_PER_TURN, *, internal: bool = False
) -> AsyncIterator[T]:
    """Iterate, and yield to the loop after each ``at_once`` items."""
    for number, item in enumerate(items):
        if number % at_once == at_once - 1:
            await yield_to_loop(internal=internal)
        yield item


async def encode_json_cooperatively(message: Any, *, internal: bool = False) -> bytes:
    """Return a message as compact JSON, encoded in turns: a list of 300 drives takes 13 ms at once.

    Raises ValueError for a number that JSON does not have.
    """
    parts: list[str] = []
    size = 0
    for text, encoded_now in _json_pieces(message, SPLIT_LEVELS):
        parts.append(text)
        size += encoded_now
        if size >= MAX_CHUNK_CHARS:
            size = 0
            await yield_to_loop(internal=internal)
    return "".join(parts).encode()


class EncodedOnce(dict[str, Any]):
    """JSON object that does not change any more. It is encoded at its first use and shared by all later messages."""

    __slots__ = ("_text",)

    def encode(self) -> tuple[str, int]:
        """Return its JSON, and the number of characters that were encoded now."""
        try:
            return self._text, 0
        except AttributeError:
            self._text: str = COMPACT_ENCODER.encode(self)
            return self._text, len(self._text)

    def extended(self, **members: Any) -> EncodedOnce:
        """Return this object, which has a member at least, with others added. Only those are encoded for it."""
        longer = EncodedOnce(self)
        longer.update(members)
        longer._text = f"{self.encode()[0][:-1]},{COMPACT_ENCODER.encode(members)[1:]}"
        return longer


def _json_pieces(value: Any, deep: int) -> Iterator[tuple[str, int]]:
    """Yield the JSON of a value in pieces, each with the number of characters that had to be encoded for it.

    A dict with keys that are no text is one piece.
    """
    if isinstance(value, EncodedOnce):
        yield value.encode()
        return
    named = isinstance(value, dict) and all(isinstance(key, str) for key in value)
    if not deep or not value or not (named or isinstance(value, list)):
        text = COMPACT_ENCODER.encode(value)
        yield text, len(text)
        return
    for place, item in enumerate(value.items() if named else value):
        yield ("{" if named else "[") if place == 0 else ",", 1
        if named:
            key = f"{COMPACT_ENCODER.encode(item[0])}:"
            yield key, len(key)
        yield from _json_pieces(item[1] if named else item, deep - 1)
    yield "}" if named else "]", 1
