"""Long work of the plant's loop in pieces: no answer, however long, stands in front of a stop (G06)."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Sequence
from typing import TypeVar

T = TypeVar("T")
AT_ONCE = 8
"""So many drives or frames are told without a pause: a millisecond or two."""


async def by_and_by(many: Sequence[T], at_once: int = AT_ONCE) -> AsyncIterator[T]:
    """One after another, with the buses' turn after each ``at_once`` of them."""
    for number, one in enumerate(many):
        if number % at_once == at_once - 1:
            await asyncio.sleep(0)
        yield one
