"""Age of a command and of its checks, and the limits beyond which the user no longer expects its effect."""

from __future__ import annotations

from math import inf, isfinite

from drivebus.bus.messages import BusResult
from drivebus.drives import permissives
from drivebus.drives.permissives import CommandKind
from drivebus.errors import Expired

CHECKS_TIMEOUT_S = 5.0  # limit from the request of a command to the end of its checks
CHECKS_TIMEOUT_TRANSACTIONS = 40  # the checks may take so many transactions where that is longer (300 baud: 25 s)


class CommandAge:
    """Age of a command and of its checks."""

    def __init__(self, requested_at: float | None, checks_started_at: float | None) -> None:
        self.requested_at = requested_at  # None: the age of the command counts from the end of its checks
        self.checks_started_at = checks_started_at  # None: the checks have not started
        self.fastest_transaction_s = inf  # shortest transaction so far, from the gap before it: the speed of this bus
        self.longest_pause_s = 0.0  # longest time between two replies: no operation pauses by itself for so long
        self._last_reply_at: float | None = None

    def add(self, result: BusResult) -> None:
        """Take a transaction into account."""
        if result.sent_at is not None and result.received_at is not None:
            transaction_s = result.gap_s + result.received_at - result.sent_at
            self.fastest_transaction_s = min(self.fastest_transaction_s, transaction_s)
        if result.received_at is not None:
            if self._last_reply_at is not None:
                self.longest_pause_s = max(self.longest_pause_s, result.received_at - self._last_reply_at)
            self._last_reply_at = result.received_at

    def check(self, now: float) -> None:
        """Raise Expired where the checks took so long that a command after them would surprise the user.

        So does a pause as long before the checks, in an earlier run of the same command: the host was suspended.
        """
        transactions_s = CHECKS_TIMEOUT_TRANSACTIONS * self.fastest_transaction_s
        limit_s = max(CHECKS_TIMEOUT_S, transactions_s if isfinite(transactions_s) else 0.0)
        age_s = 0.0 if self.checks_started_at is None else now - self.checks_started_at
        age_s = max(age_s, self.longest_pause_s)
        if age_s > limit_s:
            raise Expired("drives.checks_timeout", age_s=round(age_s, 2), limit_s=round(limit_s, 1))

    def created_at(self, kind: CommandKind, now: float) -> float:
        """Return the creation time of a command: now, but no command outlives its request by more than 5 s."""
        if self.requested_at is None:
            return now
        return min(now, self.requested_at + max(0.0, CHECKS_TIMEOUT_S - permissives.COMMAND_TTL_S[kind]))
