"""Usual reply delay of a poll or station: the received bytes wait in the kernel until its reply is probably complete.

One read of a whole reply costs the processor half as much as several reads of its parts. The delay only decides when
bytes are read, never whether they are accepted; a reply that is not complete by then is read as it comes.
"""

from __future__ import annotations

DELAY_STEP_S = 20e-6
"""Correction by one reply: less than a tenth of a character at 38,400 baud."""
MAX_SCATTER_S = 0.5e-3
"""Longest time after the usual delay at which a reply still raises it. Where delays scatter by more (an adapter that
delivers every 16 ms), it settles near the shortest ones, so that few replies are read late."""


class UsualDelay:
    """Reply delay by which about half of the replies to a poll, or of a station, are complete, learned from them."""

    __slots__ = ("_decrease_s", "_first_s", "seconds")

    def __init__(self) -> None:
        self.seconds = 0.0
        """0.0 before the second reply."""
        self._first_s: float | None = None
        self._decrease_s = 0.0

    def add(self, delay_s: float, *, read_at_once: bool) -> None:
        """Add the delay of a reply. ``read_at_once``: the first read got all of it, so it may have come earlier."""
        if self._first_s is None:
            self._first_s = delay_s
        elif self._decrease_s == 0.0:  # the first reply may have been read late: a program is busy at its start
            self.seconds = max(0.0, min(self._first_s, delay_s))
            self._decrease_s = DELAY_STEP_S
        elif read_at_once:  # twice as much each time, because a drive may have become much faster
            self.seconds = max(0.0, self.seconds - self._decrease_s)
            self._decrease_s *= 2
        else:
            self._decrease_s = DELAY_STEP_S
            if delay_s < self.seconds + MAX_SCATTER_S:
                self.seconds += DELAY_STEP_S
