"""Jog through a service: each key repeat renews it, its end stops the drive, a lost jog is stopped."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any, cast

import pytest

from drivebus import profiles
from drivebus.cli.errors import ExitCode, exit_code_of
from drivebus.cli.remote.drive import RemoteDrive
from drivebus.drives.state import Direction
from drivebus.errors import DrivebusError, NotFound, OutcomeUnknown, ServiceUnavailable, StartInhibited
from drivebus.testing import virtual_time
from drivebus.types import Json

TEXT = {"en": "done", "zh": "完成"}
OUTCOME = {"status": "confirmed", "key": "x", "text": TEXT, "params": {}, "notes": [], "frames": []}


class FakeClient:
    """Client that records the calls and returns the results of a service."""

    def __init__(self, *, is_local: bool = False, **errors: DrivebusError) -> None:
        self.is_local = is_local
        self.errors = errors
        self.calls: list[tuple[str, Json]] = []

    async def call(self, operation: str, params: Json) -> Json:
        self.calls.append((operation, {name: value for name, value in params.items() if name != "drive"}))
        await asyncio.sleep(0.01)
        if operation.partition(".")[2] in self.errors:
            raise self.errors[operation.partition(".")[2]]
        results: dict[str, Json] = {
            "drives.get": {"lease": None},
            "lease.take": {"lease": {"session": "s"}},
            "drive.arm": {"arm_token": "word"},
            "drive.jog": {"jog": "j", "lease_s": 0.5, "outcome": OUTCOME},
        }
        return results.get(operation, {"outcome": OUTCOME})

    async def close(self) -> None:
        return

    @property
    def operations(self) -> list[str]:
        return [name for name, _ in self.calls]


def play(scenario: Callable[[], Coroutine[Any, Any, None]]) -> None:
    virtual_time.run(scenario())


def drive(client: FakeClient) -> RemoteDrive:
    return RemoteDrive(cast(Any, client), "fan-1", 1, profiles.load("c320"))


@pytest.mark.parametrize("is_local", [False, True])
def test_a_jog_is_started_renewed_and_ended(is_local: bool) -> None:
    async def scenario() -> None:
        client = FakeClient(is_local=is_local)
        fan = drive(client)
        async with fan.jog(5.0, Direction.REVERSE) as jog:
            for _ in range(3):
                jog.renew()
                await asyncio.sleep(0.1)
        await fan.close()
        steps = [] if is_local else ["drive.arm"]
        start = ["drives.get", "lease.take", *steps, "drive.jog"]
        assert client.operations == [*start, *["drive.jog_renew"] * 3, "drive.jog_end", "lease.release"]
        params = {"direction": "reverse", "frequency_hz": 5.0} | ({} if is_local else {"arm_token": "word"})
        assert dict(client.calls)["drive.jog"] == params and jog.stop_outcome is not None and jog.stop_outcome.succeeded

    play(scenario)


def test_a_jog_is_not_renewed_by_itself() -> None:
    async def scenario() -> None:
        client = FakeClient(is_local=True)
        async with drive(client).jog(None, Direction.FORWARD):
            await asyncio.sleep(5.0)
        assert "drive.jog_renew" not in client.operations

    play(scenario)


def test_a_jog_that_the_service_has_ended_is_an_error_and_the_drive_is_stopped() -> None:
    async def scenario() -> None:
        lost, gone = StartInhibited("drives.jog_lease_expired", lease_s=0.5), NotFound("plant.no_jog", id="fan-1")
        client = FakeClient(is_local=True, jog_renew=lost, jog_end=gone)
        with pytest.raises(StartInhibited):
            async with drive(client).jog(None, Direction.FORWARD) as jog:
                jog.renew()
                await asyncio.sleep(0.1)
                jog.renew()
        assert client.operations[-1] == "drive.stop"

    play(scenario)


@pytest.mark.parametrize(("may_be_running", "last"), [(None, "drive.stop"), (True, "drive.stop"), (False, "drive.jog")])
def test_a_jog_whose_start_fails_is_stopped_unless_the_service_knows_that_nothing_moves(
    may_be_running: bool | None, last: str
) -> None:
    """Regression: nothing followed a jog whose answer was lost, as a stop follows such a run."""

    async def scenario() -> None:
        error = OutcomeUnknown("service.lost", operation="drive.jog")
        error.may_be_running = may_be_running
        client = FakeClient(jog=error)
        with pytest.raises(OutcomeUnknown):
            async with drive(client).jog(None, Direction.FORWARD):
                pass
        assert client.operations[-1] == last

    play(scenario)


def test_a_jog_that_cannot_be_armed_is_not_stopped() -> None:
    """The drive may be run by another user."""

    async def scenario() -> None:
        client = FakeClient(arm=OutcomeUnknown("service.lost", operation="drive.arm"))
        with pytest.raises(OutcomeUnknown):
            async with drive(client).jog(None, Direction.FORWARD):
                pass
        assert client.operations[-1] == "drive.arm"

    play(scenario)


def test_a_jog_whose_service_is_lost_ends_with_an_unknown_stop_that_names_the_drive() -> None:
    """It ended as any request to a lost service: with 1, and without a word of the motor that may run on."""

    async def scenario() -> None:
        client = FakeClient(is_local=True, jog_end=ServiceUnavailable("plant.not_there", socket="plant.sock"))
        with pytest.raises(OutcomeUnknown) as caught:
            async with drive(client).jog(None, Direction.FORWARD):
                pass
        assert caught.value.key == "service.not_stopped" and "fan-1 could not be stopped" in str(caught.value)
        assert exit_code_of(caught.value) is ExitCode.UNKNOWN

    play(scenario)


def test_the_status_of_a_jog_is_newer_than_its_start() -> None:
    """The direction of the jog before it would be remarked on."""

    class LateClient(FakeClient):
        """Client of a service that reads the state of the drive after two requests."""

        async def call(self, operation: str, params: Json) -> Json:
            result = await super().call(operation, params)
            if operation != "drives.get" or "drive.jog" not in self.operations:
                return result
            is_new = self.operations[-1:-4:-1].count("drives.get") == 3
            view = {"state": "jogging", "direction": "forward" if is_new else "reverse", "state_reason": None}
            times = {"time_ms": 10_000, "state_time_ms": 10_000 if is_new else 5_000}
            return view | times | {"signals": {}, "fault": None, "last_stop": None}

    async def scenario() -> None:
        fan = drive(LateClient(is_local=True))
        async with fan.jog(5.0, Direction.FORWARD):
            assert (await fan.status()).direction is Direction.FORWARD
        await fan.close()

    play(scenario)


def test_a_lease_is_renewed_until_close_and_then_released() -> None:
    async def scenario() -> None:
        client = FakeClient()
        fan = drive(client)
        await fan.set_frequency(5.0)
        await asyncio.sleep(10.0)
        await fan.close()
        assert client.operations.count("lease.renew") == 3 and client.operations[-1] == "lease.release"

    play(scenario)
