"""Audit records of commands: each has an outcome, also after an unexpected error."""

from __future__ import annotations

import asyncio
import logging
from typing import Any

import pytest

from drivebus import i18n
from drivebus.service.audit import AuditEntry
from drivebus.testing.virtual_time import run
from fixtures.service import ServiceKit, running_service

OPERATIONS: dict[str, dict[str, Any]] = {
    "drive.set_frequency": {"frequency_hz": 20.0},
    "drive.reset": {},
    "drive.stop": {},
}


def break_drive(kit: ServiceKit, operation: str, error: type[BaseException]) -> None:
    """Make an operation of the drive raise an error that is no ``DrivebusError``."""

    async def broken(*_: Any, **__: Any) -> None:
        await asyncio.sleep(0.1)
        raise error

    method = {"drive.reset": "reset_fault"}.get(operation, operation.partition(".")[2])
    setattr(kit.service.plant.drives["fan-1"].drive, method, broken)


def records(kit: ServiceKit, operation: str) -> list[tuple[str | None, Any, int | None]]:
    entries = [entry for entry in kit.trail.entries if entry.what == operation]
    return [(entry.outcome, entry.params.get("error"), entry.of) for entry in entries]


@pytest.mark.parametrize("operation", OPERATIONS)
@pytest.mark.parametrize("error", [ZeroDivisionError, asyncio.CancelledError])
def test_an_unexpected_error_is_recorded_as_unknown_and_raised(operation: str, error: type[BaseException]) -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(2)
            break_drive(kit, operation, error)
            with pytest.raises(error):
                await kit.call(operation, drive="fan-1", **OPERATIONS[operation])
            *requested, ended = records(kit, operation)
            assert requested == [("requested", None, None)]
            awaits_no_number = operation == "drive.stop" and error is asyncio.CancelledError
            number = None if awaits_no_number else len(kit.trail.entries) - 1
            assert ended == ("unknown", error.__name__, number)

    run(scenario())


def test_a_record_of_the_request_that_fails_unexpectedly_does_not_lose_that_of_the_outcome(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The stop was done, and the trail had no trace of it."""

    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(2)
            logged: list[str] = []
            monkeypatch.setattr(logging.getLogger("drivebus.service"), "exception", logged.append)
            record = kit.trail.record

            async def fail_request(entry: AuditEntry) -> int:
                if entry.outcome == "requested":
                    raise ZeroDivisionError
                return await record(entry)

            monkeypatch.setattr(kit.trail, "record", fail_request)
            await kit.call("drive.stop", drive="fan-1")
            assert records(kit, "drive.stop") == [("confirmed", None, None)]
            assert logged == [i18n.preferred_text("log.record_failed")]

    run(scenario())


@pytest.mark.parametrize("operation", OPERATIONS)
def test_a_cancelled_command_is_recorded_as_unknown(operation: str) -> None:
    """A disk that hangs does not delay the cancelled task."""

    async def scenario(after_s: float) -> None:
        async with running_service() as kit:
            await asyncio.sleep(2)
            kit.trail.delay_s = 0.05
            command = asyncio.create_task(kit.call(operation, drive="fan-1", **OPERATIONS[operation]))
            await asyncio.sleep(after_s)
            kit.trail.delay_s = 60.0
            command.cancel()
            cancelled_at = kit.service.plant.now()
            with pytest.raises(asyncio.CancelledError):
                await command
            assert kit.service.plant.now() == cancelled_at
            assert records(kit, operation)[-1][:2] == ("unknown", "CancelledError")

    run(scenario(0.02))
    run(scenario(0.08))
