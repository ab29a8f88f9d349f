"""Order of requests on one connection: commands are called as they arrive, queries yield to them."""

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

QUERIES = [("buses.list", {})] * 20


class RecordingWriter:
    """Writer that records the messages to a client of the socket."""

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


async def send_at_once(kit: ServiceKit, *requests: tuple[str, Json]) -> list[Json]:
    """Send requests in one piece as a local user; return the replies in the order of the requests."""
    reader, writer = asyncio.StreamReader(), RecordingWriter()
    for number, (name, params) in enumerate(requests):
        message = {"id": number, "op": name, "params": params, "actor": LOCAL.as_json()}
        reader.feed_data(json.dumps(message).encode() + b"\n")
    reader.feed_eof()
    server = SocketServer(kit.service, Path("/nonexistent"))
    await server._connected(reader, cast(asyncio.StreamWriter, writer))
    return sorted(writer.messages, key=lambda message: cast(int, message["id"]))


@pytest.mark.parametrize(
    ("command", "params"),
    [("drive.run", {"frequency_hz": 20.0}), ("drive.jog", {}), ("group.start", {"group": "fans"})],
)
def test_a_stop_supersedes_an_earlier_start_while_queries_wait(command: str, params: Json) -> None:
    """By an actor whose starts need one step, behind waiting queries."""
    place = {"frequency_hz": 20.0} | params if "group" in params else {"drive": "fan-1"} | params

    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(5)
            await kit.grant_waivers()
            *_, start, stop = await send_at_once(kit, *QUERIES, (command, place), ("drive.stop", {"drive": "fan-1"}))
            assert "Superseded" in json.dumps(start) and stop["result"]["outcome"]["status"] == "confirmed"
            await asyncio.sleep(3)
            assert [kit.station(fan).motor.starts for fan in ("fan-1", "fan-2")] == [0, 0]

    run(scenario())


def test_a_stop_of_everything_inhibits_starts_after_an_earlier_release() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(5)
            release = "start_inhibit.release", {"drive": "fan-1"}
            await send_at_once(kit, *QUERIES, release, ("plant.stop", {}))
            assert (await kit.call("drives.get", drive="fan-1"))["start_inhibited"]

    run(scenario())


def test_a_jog_renewal_does_not_wait_for_queries() -> None:
    """A late renewal stops the motor of a jog and ends a lease."""

    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(5)
            call, called = kit.service.call, list[str]()

            async def record(operation: str, params: Json, actor: Any) -> Json:
                called.append(operation)
                return await call(operation, params, actor)

            kit.service.call = record  # type: ignore[method-assign]
            renewals = [(name, {"drive": "fan-1"}) for name in ("drive.jog_renew", "lease.renew")]
            await send_at_once(kit, *QUERIES, *renewals)
            assert len(called) == 22 and max(map(called.index, ("drive.jog_renew", "lease.renew"))) < 5

    run(scenario())


def test_only_operations_without_effect_yield() -> None:
    immediate = {name for name, operation in OPERATIONS.items() if not operation.yields}
    assert immediate == {name for name, operation in OPERATIONS.items() if operation.mutates} | {
        "lease.renew",
        "drive.jog_renew",
    }


def test_a_live_message_overtakes_long_replies() -> None:
    """Replies are encoded in pieces, one after another; live messages do not wait for them."""

    async def scenario() -> None:
        writer, many = RecordingWriter(), {f"drives/{number}": {"title": "x" * 1000} for number in range(300)}
        async with running_service() as kit:
            connection = _ClientConnection(kit.service, asyncio.StreamReader(), cast(asyncio.StreamWriter, writer))
            messages = [{"id": number, "result": many} for number in range(20)] + [{"id": 20, "live": many}]
            await asyncio.gather(*map(connection._send, messages))
        assert writer.messages[0]["id"] == 20

    run(scenario())
