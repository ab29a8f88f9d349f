"""Turn an outcome into a return value or an error that carries it."""

from __future__ import annotations

from drivebus.drives.state import Outcome, OutcomeStatus
from drivebus.errors import DriveError, DriveRejected, OutcomeUnknown, StopUnconfirmed, TargetNotReached

_ERROR_CLASSES: dict[OutcomeStatus, type[DriveError]] = {
    OutcomeStatus.REFUSED: DriveRejected,
    OutcomeStatus.FAILED: TargetNotReached,
    OutcomeStatus.UNKNOWN: OutcomeUnknown,
}


def raise_for_status(outcome: Outcome, *, stop: bool = False) -> Outcome:
    """Return a confirmed or acknowledged outcome.

    Raises Refused, TargetNotReached, OutcomeUnknown, StopUnconfirmed, so that a caller
    who ignores the return value cannot take a failed command for a done one.
    """
    if outcome.succeeded:
        return outcome
    kind = StopUnconfirmed if stop else _ERROR_CLASSES[outcome.status]
    error = kind(outcome.key, **dict(outcome.params))
    error.outcome = outcome
    raise error
