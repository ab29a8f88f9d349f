"""Errors of a command that stops: each says that the stop was not sent or is not confirmed."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import click

from drivebus.cli import output
from drivebus.errors import (
    ConfigurationError,
    InvalidParameters,
    NotFound,
    OutcomeUnknown,
    PermissionDenied,
    PortUnavailable,
    ServiceUnavailable,
    StopUnconfirmed,
)
from drivebus.terminal import discard_terminal_output
from drivebus.values import Text

_BEFORE_ANY_FRAME = (click.UsageError, ConfigurationError, InvalidParameters, NotFound, PermissionDenied)
"""Errors with which a stop ends only before its first frame."""


@contextmanager
def note_no_stop() -> Iterator[None]:
    """Add to an error before the first frame that no stop was sent, and what stops the drive now."""
    try:
        yield
    except _BEFORE_ANY_FRAME as error:
        error.add_note(output.text("bus_stop.none_sent"))
        raise


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
def stop_to_the_end(*, dry_run: bool) -> Iterator[None]:
    """Send and confirm a stop although the terminal is closed, Ctrl-Z is pressed or the output can't be written.

    Raises StopUnconfirmed where Ctrl-C, Ctrl-\\ or a request to terminate ends it: it is not known whether it was sent.
    A dry run sends none.
    """
    if dry_run:
        yield
        return
    try:
        with output.continue_without_output(), _stop_signals():
            yield
    except KeyboardInterrupt:
        raise StopUnconfirmed("bus_stop.interrupted") from None


@contextmanager
def _stop_signals() -> Iterator[None]:
    """Ignore a closed terminal and Ctrl-Z, which would suspend the stop; let a request to terminate act as Ctrl-C.

    A signal that is ignored or handled already, as by ``nohup``, stays as it is.
    """
    handlers: dict[str, Any] = {
        "SIGHUP": lambda *_: discard_terminal_output(),
        "SIGTSTP": signal.SIG_IGN,
        "SIGTERM": signal.default_int_handler,
        "SIGQUIT": signal.default_int_handler,
    }
    numbers = {getattr(signal, name, None): handler for name, handler in handlers.items()}
    replaced = [number for number in numbers if number is not None and signal.getsignal(number) is signal.SIG_DFL]
    for number in replaced:
        signal.signal(number, numbers[number])
    try:
        yield
    finally:
        for number in replaced:
            signal.signal(number, signal.SIG_DFL)
