"""``UserQuota``: places that users share, such as WebSockets or places in a queue."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager


class UserQuota:
    """Limited number of places; a user gets a further one while it holds fewer than are free.

    One user alone gets half of them, a second one then half of the rest, so that two together leave some, too.
    """

    def __init__(self, places: int) -> None:
        self._places = places
        self._held: Counter[str | None] = Counter()

    @property
    def held(self) -> int:
        """Number of places that are held."""
        return self._held.total()

    def has_place(self, user: str | None) -> bool:
        """Return whether there is a place for a user; without a user any free one is."""
        free = self._places - self.held
        return free > 0 if user is None else self._held[user] < free

    @contextmanager
    def place(self, user: str | None) -> Iterator[None]:
        """Hold a place for the block; ask ``has_place`` before."""
        self._held[user] += 1
        try:
            yield
        finally:
            self._held -= Counter({user: 1})  # without users who hold none
