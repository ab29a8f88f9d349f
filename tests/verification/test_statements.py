"""The campaign ``statements`` finds untrue sentences that are planted."""

from __future__ import annotations

from typing import Any

import pytest

from drivebus import i18n
from drivebus.bus import failure_reason
from drivebus.drives.operations import parameters, reset, start, stop
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.outcome import OutcomeStatus
from drivebus.errors import NoReply
from fixtures.campaigns import finds
from verification.campaigns import statements


def plant(monkeypatch: pytest.MonkeyPatch, module: Any, name: str, key: str) -> None:
    """Confirm an operation without evidence."""

    def at_once(op: Any, *arguments: Any, **named: Any) -> Any:
        yield from ()
        return op.outcome(OutcomeStatus.CONFIRMED, key)

    monkeypatch.setattr(module, name, at_once)


def test_a_stop_confirmed_while_the_drive_runs_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    plant(monkeypatch, stop, "_until_confirmed", "drives.stop_confirmed")
    assert finds("statements", "the output is on", 300)


def test_a_start_confirmed_without_a_run_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    plant(monkeypatch, start, "confirm_start", "drives.start_confirmed")
    assert finds("statements", "the output was never on", 300)


def test_a_reset_confirmed_in_a_fault_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(statements, "METHODS", {"run": 1, "reset_fault": 2, "scan": 0})
    monkeypatch.setattr(statements, "MISBEHAVIOURS", ("ignores_reset", "trips"))
    plant(monkeypatch, reset, "_wait_until_cleared", "drives.reset_confirmed")
    assert finds("statements", "fault 5 is present", 300)


def test_a_write_confirmed_with_another_value_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def at_once(op: Any, write: Any, *, answered: bool, params: Any) -> Any:
        yield from ()
        return op.outcome(OutcomeStatus.CONFIRMED, "drives.write_confirmed", **params)

    monkeypatch.setattr(parameters, "_read_back", at_once)
    assert finds("statements", "the drive holds", 300)


def test_silence_claimed_of_a_drive_that_sends_bytes_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The reading was "the drive does not reply" where its reply had only stray bytes around it."""
    message = i18n.text
    lie = "the drive does not reply"
    monkeypatch.setattr(
        i18n, "text", lambda key, language, **more: lie if key == "drives.no_answer" else message(key, language, **more)
    )
    assert finds("statements", "every request was followed by bytes of the drive", 300)


def test_a_wrong_lateness_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    original = failure_reason.late_reply

    def later(*arguments: Any) -> NoReply | None:
        error = original(*arguments)
        return error and NoReply(error.key, **error.params | {"milliseconds": 5000})

    monkeypatch.setattr(failure_reason, "late_reply", later)
    assert finds("statements", "replies came after", 600)


def test_a_frequency_that_was_never_reported_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    output = OperationContext.output_hz
    monkeypatch.setattr(OperationContext, "output_hz", lambda op: (output(op) or 0.0) + 0.02)
    assert finds("statements", "was never reported", 600)
