"""``RecordBudget``: size of the audit records that the commands of a user, or of the user's tokens, may take. Pure."""

from __future__ import annotations

from math import ceil

from drivebus.errors import TooManyCommands
from drivebus.service.audit import AuditEntry
from drivebus.service.audit.records import record_octets
from drivebus.service.auth.actor import Actor

MAX_BURST_OCTETS = 4_000_000  # at once: about 3,500 refused commands, or 1,300 stops
RECORD_OCTETS_PER_S = 5_000  # afterwards: 0.43 GB a day, about four refused commands a second


class RecordBudget:
    """Budgets of a user, for all sessions and for all tokens, as token buckets; ``now`` is in monotonic seconds.

    A user can have any number of sessions and tokens, one after the other: a budget of each would limit nothing. A
    faulty program does not use up that of the person. Local actors have no limit; an excess has to be regained, too.
    """

    def __init__(self) -> None:
        self._full_at: dict[tuple[str, bool], float] = {}
        """User, whether by token → time at which the budget will be whole again."""

    def wait_s(self, actor: Actor, now: float) -> float:
        """Return the seconds until the actor's budget is no longer used up; 0 or more."""
        left_s = self._full_at.get(_holder(actor), now) - now - MAX_BURST_OCTETS / RECORD_OCTETS_PER_S
        return max(0.0, left_s) if actor.remote else 0.0

    def check(self, actor: Actor, now: float) -> None:
        """Raise TooManyCommands while the actor's budget is used up."""
        wait_s = self.wait_s(actor, now)
        if wait_s > 0:
            raise TooManyCommands("plant.too_many_commands", name=actor.user, retry_s=ceil(10 * wait_s) / 10)

    def charge(self, actor: Actor, entry: AuditEntry, now: float) -> None:
        """Charge the entry of an outcome, and that of its request, which is no larger."""
        if actor.remote:
            self.spend(actor, 2 * record_octets(entry), now)

    def spend(self, actor: Actor, octets: int, now: float) -> None:
        """Take ``octets`` from the actor's budget."""
        if actor.remote:
            holder = _holder(actor)
            self._full_at = {each: full_at for each, full_at in self._full_at.items() if now < full_at}
            self._full_at[holder] = self._full_at.get(holder, now) + octets / RECORD_OCTETS_PER_S


def _holder(actor: Actor) -> tuple[str, bool]:
    return actor.user, actor.is_program
