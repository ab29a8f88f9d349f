"""What can wait is done in pieces, one each time round the event loop: nothing stands in front of a stop (G06, S14).

Commands ask for no turn: a stop would come before a start that was asked earlier, and would not void it (6.5).
"""

from __future__ import annotations

import asyncio
import json
from collections import deque
from collections.abc import AsyncIterator, Iterator, Sequence
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

T = TypeVar("T")
ITEMS_PER_TURN = 8
"""So many drives or frames are told without a pause: a millisecond or two."""
MAX_CHUNK_CHARS = 32 * 1024
"""So many characters are encoded without a pause: a millisecond or less."""
SPLIT_LEVELS = 3
"""Levels of an answer that are taken apart: the message, what is in it, and its list of drives or frames."""


class _TurnQueue:
    """Who waits on one loop, the longest waiting first; questions and what tells of the drives by itself by turns."""

    def __init__(self) -> None:
        self._kinds: deque[deque[asyncio.Future[None]]] = deque((deque(), deque()))
        self._of = dict(zip((False, True), self._kinds, strict=True))

    def wait(self, loop: asyncio.AbstractEventLoop, own: bool) -> asyncio.Future[None]:
        mine = loop.create_future()
        if not any(self._kinds):
            loop.call_soon(self._next, loop)
        self._of[own].append(mine)
        return mine

    def _next(self, loop: asyncio.AbstractEventLoop) -> None:
        """Who was cancelled meanwhile has no turn."""
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
    """Wait for it: of all that asks for turns on this loop, one goes on each time round.

    ``own``: live values and cases, which nobody's questions hold up: they have every second turn (G17).
    """
    loop = asyncio.get_running_loop()
    if (turns := _QUEUES.get(loop)) is None:
        turns = _QUEUES[loop] = _TurnQueue()
    await turns.wait(loop, internal)


COMPACT_ENCODER = json.JSONEncoder(ensure_ascii=False, separators=(",", ":"), allow_nan=False)


async def iter_cooperatively(
    many: Sequence[T], at_once: int = ITEMS_PER_TURN, *, internal: bool = False
) -> AsyncIterator[T]:
    """One after another, with the buses' turn after each ``at_once`` of them."""
    for number, one in enumerate(many):
        if number % at_once == at_once - 1:
            await yield_to_loop(internal=internal)
        yield one


async def encode_json_cooperatively(message: Any, *, internal: bool = False) -> bytes:
    """The message as compact JSON, with the buses' turn in between: a list of 300 drives takes 13 ms in one go.

    Raises ValueError for a number that is none in JSON.
    """
    parts: list[str] = []
    size = 0
    for text in _json_pieces(message, SPLIT_LEVELS):
        parts.append(text)
        size += len(text)
        if size >= MAX_CHUNK_CHARS:
            size = 0
            await yield_to_loop(internal=internal)
    return "".join(parts).encode()


def _json_pieces(value: Any, deep: int) -> Iterator[str]:
    """What comes one after another in the JSON of a value; a dict whose keys are no text is left whole."""
    named = isinstance(value, dict) and all(isinstance(key, str) for key in value)
    if not deep or not value or not (named or isinstance(value, list)):
        yield COMPACT_ENCODER.encode(value)
        return
    for place, one in enumerate(value.items() if named else value):
        yield ("{" if named else "[") if place == 0 else ","
        if named:
            yield f"{COMPACT_ENCODER.encode(one[0])}:"
        yield from _json_pieces(one[1] if named else one, deep - 1)
    yield "}" if named else "]"
