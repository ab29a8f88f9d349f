"""``RecordBudget``: size of the audit records that the commands of one user may take. Pure."""

from __future__ import annotations

from math import ceil

from drivebus.errors import TooManyCommands
from drivebus.service.auth.actor import Actor

MAX_BURST_OCTETS = 4_000_000  # at once: about 3,500 refused commands, or 1,300 stops
RECORD_OCTETS_PER_S = 5_000  # afterwards: 0.43 GB a day, about four refused commands a second


class RecordBudget:
    """Budget of each user with the user's tokens, as a token bucket; ``now`` is in monotonic seconds.

    A user can have any number of sessions and tokens, one after the other: a budget of each would limit nothing. Local
    actors have no limit. What is being recorded may exceed a budget; the excess has to be regained, too.
    """

    def __init__(self) -> None:
        self._full_at: dict[str, float] = {}
        """User → time at which the budget will be whole again."""

    def wait_s(self, actor: Actor, now: float) -> float:
        """Return the seconds until the actor's budget is no longer used up; 0 or more."""
        left_s = self._full_at.get(actor.user, now) - now - MAX_BURST_OCTETS / RECORD_OCTETS_PER_S
        return max(0.0, left_s) if actor.remote else 0.0

    def check(self, actor: Actor, now: float) -> None:
        """Raise TooManyCommands while the actor's budget is used up."""
        wait_s = self.wait_s(actor, now)
        if wait_s > 0:
            raise TooManyCommands("plant.too_many_commands", name=actor.user, retry_s=ceil(10 * wait_s) / 10)

    def spend(self, actor: Actor, octets: int, now: float) -> None:
        """Take ``octets`` from the actor's budget."""
        if actor.remote:
            self._full_at = {user: full_at for user, full_at in self._full_at.items() if now < full_at}
            self._full_at[actor.user] = self._full_at.get(actor.user, now) + octets / RECORD_OCTETS_PER_S
