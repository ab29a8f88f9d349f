"""``RecordBudget``: size of the audit records that the commands of one actor may take. Pure."""

from __future__ import annotations

MAX_BURST_OCTETS = 4_000_000  # at once: about 3,500 refused commands, or 1,300 stops
RECORD_OCTETS_PER_S = 5_000  # afterwards: 0.43 GB a day, about four refused commands a second


class RecordBudget:
    """Budget of each key, as a token bucket; ``now`` is in monotonic seconds.

    What is being recorded may exceed it; the excess has to be regained, too.
    """

    def __init__(self) -> None:
        self._full_at: dict[str, float] = {}
        """Key → time at which its budget will be whole again."""

    def wait_s(self, key: str, now: float) -> float:
        """Return the seconds until the budget of ``key`` is no longer used up; 0 or more."""
        return max(0.0, self._full_at.get(key, now) - now - MAX_BURST_OCTETS / RECORD_OCTETS_PER_S)

    def spend(self, key: str, octets: int, now: float) -> None:
        """Take ``octets`` from the budget of ``key``."""
        self._full_at = {one: full_at for one, full_at in self._full_at.items() if now < full_at}
        self._full_at[key] = self._full_at.get(key, now) + octets / RECORD_OCTETS_PER_S
