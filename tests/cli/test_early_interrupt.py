"""Signals before a command has handlers of its own."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import pytest

from drivebus.cli.early_interrupt import end_interrupt_on_sigterm, interrupt_on_sigterm, is_early_interrupt


@pytest.fixture(autouse=True)
def handler() -> Iterator[None]:
    before = signal.getsignal(signal.SIGTERM)
    yield
    signal.signal(signal.SIGTERM, before)


def test_an_ignored_sigterm_stays_ignored() -> None:
    """A stop under ``trap '' TERM`` was interrupted: the default action had taken the place of the ignored signal."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    interrupt_on_sigterm()
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_IGN
    assert is_early_interrupt(KeyboardInterrupt()), "Ctrl-C is not ignored"
    end_interrupt_on_sigterm()
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_IGN


def test_sigterm_is_as_ctrl_c_until_a_command_begins_or_handles_it() -> None:
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    interrupt_on_sigterm()
    assert is_early_interrupt(KeyboardInterrupt()) and not is_early_interrupt(RuntimeError())
    end_interrupt_on_sigterm()
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    interrupt_on_sigterm()
    signal.signal(signal.SIGTERM, ignored := lambda *_: None)
    end_interrupt_on_sigterm()
    assert signal.getsignal(signal.SIGTERM) is ignored and not is_early_interrupt(KeyboardInterrupt())
