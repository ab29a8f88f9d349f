"""Every command has an end in the audit trail, also after an unexpected error."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from drivebus.testing.virtual_time import run
from fixtures.service import ServiceKit, running_service

OPERATIONS: dict[str, dict[str, Any]] = {
    "drive.set_frequency": {"frequency_hz": 20.0},
    "drive.reset": {},
    "drive.stop": {},
}


def breaks(kit: ServiceKit, operation: str, how: type[BaseException]) -> None:
    """The drive fails at it in a way that is no error of ours."""

    async def broken(*_: Any, **__: Any) -> None:
        await asyncio.sleep(0.1)
        raise how

    verb = {"drive.reset": "reset_fault"}.get(operation, operation.partition(".")[2])
    setattr(kit.service.plant.drives["fan-1"].drive, verb, broken)


def recorded(kit: ServiceKit, operation: str) -> list[tuple[str | None, Any, int | None]]:
    return [(one.outcome, one.params.get("error"), one.of) for one in kit.trail.entries if one.what == operation]


@pytest.mark.parametrize("operation", OPERATIONS)
@pytest.mark.parametrize("how", [ZeroDivisionError, asyncio.CancelledError])
def test_an_unexpected_error_is_recorded_as_unknown_and_raised(operation: str, how: type[BaseException]) -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(2)
            breaks(kit, operation, how)
            with pytest.raises(how):
                await kit.call(operation, drive="fan-1", **OPERATIONS[operation])
            *asked, ended = recorded(kit, operation)
            number = len(kit.trail.entries) - 1 if asked else None
            assert asked == ([] if operation == "drive.stop" else [("requested", None, None)])
            assert ended == ("unknown", how.__name__, number)

    run(scenario())


@pytest.mark.parametrize("operation", OPERATIONS)
def test_a_cancelled_command_is_still_recorded_with_an_end(operation: str) -> None:
    """A disk that hangs does not keep a cancelled task."""

    async def story(after_s: float) -> None:
        async with running_service() as kit:
            await asyncio.sleep(2)
            kit.trail.delay_s = 0.05
            asking = asyncio.create_task(kit.call(operation, drive="fan-1", **OPERATIONS[operation]))
            await asyncio.sleep(after_s)
            kit.trail.delay_s = 60.0
            asking.cancel()
            begun = kit.service.plant.now()
            with pytest.raises(asyncio.CancelledError):
                await asking
            assert kit.service.plant.now() == begun
            assert recorded(kit, operation)[-1][:2] == ("unknown", "CancelledError")

    run(story(0.02))
    run(story(0.08))
