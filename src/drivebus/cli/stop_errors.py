"""Errors of a command that stops: each says that the stop was not sent or is not confirmed, and ends with code 4."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from drivebus.errors import OutcomeUnknown, PortUnavailable, ServiceUnavailable, StopUnconfirmed
from drivebus.values import Text


@contextmanager
def stop_errors(name: str | None) -> Iterator[None]:
    """Raise StopUnconfirmed where the port of a stop can't be opened, OutcomeUnknown where its service is away.

    ``name``: the drive or the service.
    """
    try:
        yield
    except PortUnavailable as error:
        raise StopUnconfirmed("bus_stop.not_sent", why=Text.per_language(error.text)) from error
    except ServiceUnavailable as error:
        raise OutcomeUnknown("service.not_stopped", drive=name or "-", why=error) from error


@contextmanager
def interruption_is_unconfirmed(*, dry_run: bool) -> Iterator[None]:
    """Raise StopUnconfirmed where Ctrl-C ends a stop: it is not known whether it was sent. A dry run sends none."""
    try:
        yield
    except KeyboardInterrupt:
        if dry_run:
            raise
        raise StopUnconfirmed("bus_stop.interrupted") from None
