"""Long work of the plant's loop in pieces: no answer, however long, stands in front of a stop (G06)."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Sequence
from typing import TypeVar

T = TypeVar("T")
AT_ONCE = 8
"""So many drives or frames are told without a pause: a millisecond or two."""


async def by_and_by(many: Sequence[T]) -> AsyncIterator[T]:
    """One after another, with the buses' turn in between."""
    for number, one in enumerate(many):
        if number % AT_ONCE == AT_ONCE - 1:
            await asyncio.sleep(0)
        yield one
