"""A jog held through a service: each repeat of the key is told, letting go ends it, a lost one is stopped (T13)."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any, cast

import pytest

from drivebus import profiles
from drivebus.cli.remote.drive import RemoteDrive
from drivebus.drives.state import Direction
from drivebus.errors import DrivebusError, NotFound, StartInhibited
from drivebus.testing import virtual_time
from drivebus.types import Json

TEXT = {"en": "done", "zh": "完成"}
OUTCOME = {"status": "confirmed", "key": "x", "text": TEXT, "params": {}, "notes": [], "frames": []}


class Client:
    """Answers as a service and keeps what it was asked."""

    def __init__(self, *, is_local: bool = False, **errors: DrivebusError) -> None:
        self.is_local = is_local
        self.errors = errors
        self.asked: list[tuple[str, Json]] = []

    async def call(self, operation: str, params: Json) -> Json:
        self.asked.append((operation, {name: value for name, value in params.items() if name != "drive"}))
        await asyncio.sleep(0.01)
        if operation.partition(".")[2] in self.errors:
            raise self.errors[operation.partition(".")[2]]
        answers: dict[str, Json] = {
            "drives.get": {"lease": None},
            "lease.take": {"lease": {"session": "s"}},
            "drive.arm": {"arm_token": "word"},
            "drive.jog": {"jog": "j", "lease_s": 0.5, "outcome": OUTCOME},
        }
        return answers.get(operation, {"outcome": OUTCOME})

    async def close(self) -> None:
        return

    @property
    def operations(self) -> list[str]:
        return [name for name, _ in self.asked]


def play(story: Callable[[], Coroutine[Any, Any, None]]) -> None:
    virtual_time.run(story())


def drive(client: Client) -> RemoteDrive:
    return RemoteDrive(cast(Any, client), "fan-1", 1, profiles.load("c320"))


@pytest.mark.parametrize("is_local", [False, True])
def test_a_jog_is_begun_renewed_and_ended(is_local: bool) -> None:
    async def story() -> None:
        client = Client(is_local=is_local)
        fan = drive(client)
        async with fan.jog(5.0, Direction.REVERSE, 0.5) as held:
            for _ in range(3):
                held.renew()
                await asyncio.sleep(0.1)
        await fan.close()
        steps = [] if is_local else ["drive.arm"]
        begun = ["drives.get", "lease.take", *steps, "drive.jog"]
        assert client.operations == [*begun, *["drive.jog_renew"] * 3, "drive.jog_end", "lease.release"]
        given = {"direction": "reverse", "frequency_hz": 5.0} | ({} if is_local else {"arm_token": "word"})
        assert (
            dict(client.asked)["drive.jog"] == given and held.stop_outcome is not None and held.stop_outcome.succeeded
        )

    play(story)


def test_nobody_renews_but_the_hand() -> None:
    async def story() -> None:
        client = Client(is_local=True)
        async with drive(client).jog(None, Direction.FORWARD, 0.5):
            await asyncio.sleep(5.0)
        assert "drive.jog_renew" not in client.operations

    play(story)


def test_a_jog_that_the_service_has_ended_is_told_and_the_drive_stopped() -> None:
    async def story() -> None:
        lost, gone = StartInhibited("drives.lease_lost", lease_s=0.5), NotFound("plant.no_jog", id="fan-1")
        client = Client(is_local=True, jog_renew=lost, jog_end=gone)
        with pytest.raises(StartInhibited):
            async with drive(client).jog(None, Direction.FORWARD, 0.5) as held:
                held.renew()
                await asyncio.sleep(0.1)
                held.renew()
        assert client.operations[-1] == "drive.stop"

    play(story)


def test_a_lease_is_renewed_while_the_drive_is_ours_and_given_back_unless_we_had_it() -> None:
    async def story() -> None:
        client = Client()
        fan = drive(client)
        await fan.set_frequency(5.0)
        await asyncio.sleep(10.0)
        await fan.close()
        assert client.operations.count("lease.renew") == 3 and client.operations[-1] == "lease.release"

    play(story)
