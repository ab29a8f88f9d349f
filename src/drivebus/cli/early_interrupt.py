"""Ctrl-C and SIGTERM before a command has handlers of its own: both end it with a sentence and one exit code.

It imports nothing else of the command line, which is loaded meanwhile.
"""

from __future__ import annotations

import signal


def interrupt_on_sigterm() -> None:
    """Raise KeyboardInterrupt on SIGTERM, as on Ctrl-C, until the handler is replaced; an ignored one stays ignored."""
    if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        signal.signal(signal.SIGTERM, signal.default_int_handler)


def end_interrupt_on_sigterm() -> None:
    """Let SIGTERM end the process again, unless a command has set its own handler meanwhile."""
    if signal.getsignal(signal.SIGTERM) is signal.default_int_handler:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def is_early_interrupt(error: BaseException) -> bool:
    """Return whether an error is Ctrl-C or SIGTERM before a command had its handlers.

    Python 3.11 wraps a KeyboardInterrupt in a RuntimeError where it falls into a class body.
    """
    has_no_handler = signal.getsignal(signal.SIGTERM) in (signal.default_int_handler, signal.SIG_IGN)
    return isinstance(error.__cause__ or error, KeyboardInterrupt) and has_no_handler
