"""Ctrl-C and SIGTERM before a command has handlers of its own: both end it with a sentence and one exit code.

It imports nothing else of the command line, which is loaded meanwhile.
"""

from __future__ import annotations

import signal


def interrupt_on_sigterm() -> None:
    """Raise KeyboardInterrupt on SIGTERM, as on Ctrl-C, until the handler is replaced."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)


def end_interrupt_on_sigterm() -> bool:
    """Let SIGTERM end the process again; return False where a command has set its own handler meanwhile."""
    if signal.getsignal(signal.SIGTERM) is not signal.default_int_handler:
        return False
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    return True


def is_early_interrupt(error: BaseException) -> bool:
    """Return whether an error is Ctrl-C or SIGTERM before a command had its handlers.

    Python 3.11 wraps a KeyboardInterrupt in a RuntimeError where it falls into a class body.
    """
    return isinstance(error.__cause__ or error, KeyboardInterrupt) and end_interrupt_on_sigterm()
