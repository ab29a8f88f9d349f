"""Unknown outcome of an operation whose service was lost before it responded."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from drivebus.errors import OutcomeUnknown, ServiceError

LOST_KEYS = frozenset({"plant.gone", "plant.hangs", "plant.internal", "api.unforeseen", "service.silent"})
"""Errors of a service that was lost or failed while it had the request."""
REFUSED_STATUS = range(300, 500)
"""HTTP status of a proxy that has not forwarded a request."""


@contextmanager
def outcome_unknown_on_loss(operation: str) -> Iterator[None]:
    """Raise OutcomeUnknown where it is not known whether ``operation`` was done, if it mutates."""
    from drivebus.service.api.operations import OPERATIONS

    try:
        yield
    except ServiceError as error:
        is_of_proxy = error.key == "service.strange" and error.params["status"] not in REFUSED_STATUS
        if (is_of_proxy or error.key in LOST_KEYS) and OPERATIONS[operation].mutates:
            raise OutcomeUnknown("service.lost", operation=operation) from error
        if error.may_be_running is None:
            error.may_be_running = False  # the service has executed nothing
        raise
