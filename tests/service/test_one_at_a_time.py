"""Requests that are done one after another leave places to other users."""

from __future__ import annotations

import asyncio
from contextlib import suppress

import pytest

from drivebus.errors import ServiceUnavailable
from drivebus.testing.virtual_time import run
from fixtures.service import remote_actor, running_service


@pytest.mark.parametrize("operation", ["parameters.read", "identity.read"])
def test_one_user_does_not_keep_others_from_reading_a_bus(operation: str) -> None:
    """Forty requests of one user, again and again, took every place: each request of another user was refused."""

    async def scenario() -> None:
        async with running_service() as kit:
            names = [*kit.service.plant.drives["fan-1"].profile.parameters][:64]
            params = {"names": names} if operation == "parameters.read" else {}

            async def read_again_and_again() -> None:
                while True:
                    with suppress(ServiceUnavailable):
                        await kit.call(operation, remote_actor("eve"), drive="fan-1", **params)
                    await asyncio.sleep(0.01)

            flood = [asyncio.create_task(read_again_and_again()) for _ in range(40)]
            await asyncio.sleep(3)
            read = await kit.call("parameters.read", remote_actor("bob"), drive="fan-2", names=names[:1])
            assert read["parameters"].keys() == set(names[:1])
            for task in flood:
                task.cancel()
            await asyncio.gather(*flood, return_exceptions=True)

    run(scenario())
