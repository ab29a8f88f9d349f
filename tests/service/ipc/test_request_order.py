"""What only asks waits for its turn; what does something comes in as it was sent: a stop voids all before it."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any, cast

import pytest

from drivebus.service.api.operations import OPERATIONS
from drivebus.service.ipc.server import SocketServer, _ClientConnection
from drivebus.testing.virtual_time import run
from drivebus.types import Json
from fixtures.service import LOCAL, ServiceKit, running_service

QUESTIONS = [("buses.list", {})] * 20


class Wire:
    """What the plant writes to a client of its socket."""

    def __init__(self) -> None:
        self.transport = self
        self.messages: list[Json] = []

    def write(self, data: bytes) -> None:
        self.messages.append(json.loads(data))

    def get_write_buffer_size(self) -> int:
        return 0

    def close(self) -> None:
        return

    async def wait_closed(self) -> None:
        return


async def asked(kit: ServiceKit, *requests: tuple[str, Json]) -> list[Json]:
    """All of them in one piece over the plant's socket, by who sits at the plant; the answers as they were asked."""
    reader, wire = asyncio.StreamReader(), Wire()
    for number, (name, params) in enumerate(requests):
        message = {"id": number, "op": name, "params": params, "actor": LOCAL.as_json()}
        reader.feed_data(json.dumps(message).encode() + b"\n")
    reader.feed_eof()
    server = SocketServer(kit.service, Path("/nonexistent"))
    await server._connected(reader, cast(asyncio.StreamWriter, wire))
    return sorted(wire.messages, key=lambda message: cast(int, message["id"]))


@pytest.mark.parametrize(
    ("command", "params"),
    [("drive.run", {"frequency_hz": 20.0}), ("drive.jog", {}), ("group.start", {"group": "fans"})],
)
def test_a_stop_voids_a_start_that_came_before_it_whatever_else_waits(command: str, params: Json) -> None:
    """By an actor whose starts need one step, behind waiting queries."""
    place = {"frequency_hz": 20.0} | params if "group" in params else {"drive": "fan-1"} | params

    async def story() -> None:
        async with running_service() as kit:
            await asyncio.sleep(5)
            await kit.grant_waivers()
            *_, start, stop = await asked(kit, *QUESTIONS, (command, place), ("drive.stop", {"drive": "fan-1"}))
            assert "Superseded" in json.dumps(start) and stop["result"]["outcome"]["status"] == "confirmed"
            await asyncio.sleep(3)
            assert [kit.station(fan).motor.starts for fan in ("fan-1", "fan-2")] == [0, 0]

    run(story())


def test_a_stop_of_everything_holds_whatever_release_came_before_it() -> None:
    async def story() -> None:
        async with running_service() as kit:
            await asyncio.sleep(5)
            release = "start_inhibit.release", {"drive": "fan-1"}
            await asked(kit, *QUESTIONS, release, ("plant.stop", {}))
            assert (await kit.call("drives.get", drive="fan-1"))["start_inhibited"]

    run(story())


def test_a_jog_renewal_does_not_wait_for_queries() -> None:
    """A jog whose renewal comes late stops the motor; a lease is lost."""

    async def story() -> None:
        async with running_service() as kit:
            await asyncio.sleep(5)
            paper, before = kit.service.call, list[str]()

            async def noted(operation: str, params: Json, actor: Any) -> Json:
                before.append(operation)
                return await paper(operation, params, actor)

            kit.service.call = noted  # type: ignore[method-assign]
            renewals = [(name, {"drive": "fan-1"}) for name in ("drive.jog_renew", "lease.renew")]
            await asked(kit, *QUESTIONS, *renewals)
            assert len(before) == 22 and max(map(before.index, ("drive.jog_renew", "lease.renew"))) < 5

    run(story())


def test_what_waits_is_what_nothing_comes_of() -> None:
    message = {name for name, operation in OPERATIONS.items() if not operation.yields}
    assert message == {name for name, one in OPERATIONS.items() if one.mutates} | {"lease.renew", "drive.jog_renew"}


def test_a_live_message_overtakes_long_answers() -> None:
    """Each is encoded in pieces; only those of the answers wait behind each other."""

    async def story() -> None:
        wire, many = Wire(), {f"drives/{number}": {"title": "x" * 1000} for number in range(300)}
        async with running_service() as kit:
            connection = _ClientConnection(kit.service, asyncio.StreamReader(), cast(asyncio.StreamWriter, wire))
            messages = [{"id": number, "result": many} for number in range(20)] + [{"id": 20, "live": many}]
            await asyncio.gather(*map(connection._send, messages))
        assert wire.messages[0]["id"] == 20

    run(story())
