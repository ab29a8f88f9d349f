"""Requests that read a bus are done one after another, and one user leaves places to others."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from functools import partial

import pytest

from drivebus.errors import ServiceUnavailable
from drivebus.service.one_at_a_time import MAX_WAITING
from drivebus.testing.virtual_time import run
from fixtures.service import remote_actor, running_service


@pytest.mark.parametrize("operation", ["parameters.read", "identity.read"])
@pytest.mark.parametrize("users", [("eve",), ("eve", "mallory")], ids=["one user", "two users"])
def test_users_do_not_keep_others_from_reading_a_bus(operation: str, users: tuple[str, ...]) -> None:
    """Forty requests of a user, again and again, took every place or half of them: those of another were refused."""

    async def scenario() -> None:
        async with running_service() as kit:
            names = [*kit.service.plant.drives["fan-1"].profile.parameters][:64]
            params = {"names": names} if operation == "parameters.read" else {}

            async def read_again_and_again(user: str) -> None:
                while True:
                    with suppress(ServiceUnavailable):
                        await kit.call(operation, remote_actor(user), drive="fan-1", **params)
                    await asyncio.sleep(0.05)

            flood = [asyncio.create_task(read_again_and_again(user)) for user in users * 40]
            await asyncio.sleep(3)
            read = await kit.call("parameters.read", remote_actor("bob"), drive="fan-2", names=names[:1])
            assert read["parameters"].keys() == set(names[:1])
            for task in flood:
                task.cancel()
            await asyncio.gather(*flood, return_exceptions=True)

    run(scenario())


def test_identities_and_parameters_of_a_bus_are_read_one_after_another() -> None:
    """Identities beside the queue of the bus would go before the reads that confirm a stop."""

    async def scenario() -> None:
        async with running_service() as kit:
            names = [*kit.service.plant.drives["fan-1"].profile.parameters][:64]
            reads = [asyncio.create_task(kit.call("parameters.read", drive="fan-1", names=names))]
            await asyncio.sleep(0.1)
            read_identity = partial(kit.call, "identity.read", drive="fan-2")
            reads += [asyncio.create_task(read_identity()) for _ in range(MAX_WAITING // 2)]
            await asyncio.sleep(0.1)
            with pytest.raises(ServiceUnavailable) as refused:
                await read_identity()
            assert refused.value.key == "plant.too_busy"
            assert not any(read.done() for read in reads)
            assert all(await asyncio.gather(*reads))

    run(scenario())
