"""The plant's sockets: the same answers as in process, nobody in front of a stop, mode 0600."""

from __future__ import annotations

import asyncio
import json
import stat
from collections.abc import AsyncIterator, Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest

from drivebus.errors import InvalidParameters, LimitError, NotFound, PermissionDenied, ServiceUnavailable
from drivebus.service.api.errors import error_from_json, error_to_json
from drivebus.service.auth.actor import Actor
from drivebus.service.auth.rights import Role
from drivebus.service.ipc.client import MAX_QUEUED_LIVE_MESSAGES, SocketClient
from drivebus.service.ipc.protocol import STOP_RECEIVED
from drivebus.service.ipc.server import MAX_CONCURRENT_REQUESTS, SocketServer, StopServer
from drivebus.types import Json
from fixtures.service import LOCAL, remote_actor, running_service


def real(coroutine: Coroutine[Any, Any, None]) -> None:
    """Sockets need a real loop."""
    asyncio.run(coroutine)


async def until(fact: Callable[[], bool]) -> None:
    """What another task does is done soon."""
    for _ in range(2000):
        if fact():
            return
        await asyncio.sleep(0.005)
    raise AssertionError("it never came")


class Paper:
    """A plant that answers what it is told, or waits."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, Json, Actor]] = []
        self.recorded: list[Json] = []
        self.held = asyncio.Event()
        self.messages: asyncio.Queue[Json] = asyncio.Queue()
        self.ended = 0

    async def call(self, operation: str, params: Json, actor: Actor) -> Json:
        self.asked.append((operation, params, actor))
        if operation == "drives.list":
            await self.held.wait()
        if operation == "drive.run":
            raise LimitError("drives.above_maximum", frequency_hz=99.0, limit_hz=50.0)
        return {"operation": operation, "buses": {}, "outcomes": {}}

    async def live(self, stream: str, actor: Actor) -> AsyncIterator[Json]:
        try:
            while True:
                yield await self.messages.get()
        finally:
            self.ended += 1

    async def record(self, entry: Json, actor: Actor) -> None:
        self.recorded.append(entry)


def test_a_call_comes_with_its_actor_and_its_error_comes_back_whole(tmp_path: Path) -> None:
    async def story() -> None:
        paper = Paper()
        server, client = SocketServer(paper, tmp_path / "plant.sock"), SocketClient(tmp_path / "plant.sock")
        await server.open()
        ann = remote_actor()
        assert (await client.call("buses.list", {"a": 1}, ann))["operation"] == "buses.list"
        assert paper.asked == [("buses.list", {"a": 1}, ann)]
        with pytest.raises(LimitError) as refused:
            await client.call("drive.run", {}, ann)
        assert refused.value.params == {"frequency_hz": 99.0, "limit_hz": 50.0}
        await client.record({"what": "login"}, ann)
        assert paper.recorded == [{"what": "login"}]
        await client.close()
        await server.close()

    real(story())


def test_nothing_stands_in_front_of_a_stop(tmp_path: Path) -> None:
    """A thousand requests hang; a further one is refused, a stop comes in at once."""

    async def story() -> None:
        paper = Paper()
        server, client = SocketServer(paper, tmp_path / "plant.sock"), SocketClient(tmp_path / "plant.sock")
        await server.open()
        hanging = [asyncio.create_task(client.call("drives.list", {}, LOCAL)) for _ in range(MAX_CONCURRENT_REQUESTS)]
        await until(lambda: len(paper.asked) == MAX_CONCURRENT_REQUESTS)
        with pytest.raises(ServiceUnavailable):
            await client.call("drives.list", {}, LOCAL)
        assert (await client.call("plant.stop", {}, LOCAL))["operation"] == "plant.stop"
        paper.held.set()
        await asyncio.gather(*hanging)
        await client.close()
        await server.close()

    real(story())


def test_a_client_that_goes_takes_no_command_back_and_ends_its_live_values(tmp_path: Path) -> None:
    async def story() -> None:
        paper = Paper()
        server, client = SocketServer(paper, tmp_path / "plant.sock"), SocketClient(tmp_path / "plant.sock")
        await server.open()
        listening = asyncio.create_task(anext(client.live("state", LOCAL)))  # type: ignore[arg-type]
        paper.messages.put_nowait({"type": "snapshot"})
        assert (await listening)["type"] == "snapshot"
        asked = asyncio.create_task(client.call("drives.list", {}, LOCAL))
        await until(lambda: bool(paper.asked))
        await client.close()
        with pytest.raises(ServiceUnavailable):
            await asked
        await until(lambda: bool(paper.ended))
        paper.held.set()
        await server.close()

    real(story())


def test_a_reader_of_live_values_that_hangs_is_closed_and_keeps_nobody_waiting(tmp_path: Path) -> None:
    async def story() -> None:
        paper = Paper()
        server, client = SocketServer(paper, tmp_path / "plant.sock"), SocketClient(tmp_path / "plant.sock")
        await server.open()
        live = client.live("state", LOCAL)
        paper.messages.put_nowait({"type": "snapshot"})
        assert (await anext(live))["type"] == "snapshot"
        for number in range(MAX_QUEUED_LIVE_MESSAGES + 10):
            paper.messages.put_nowait({"type": "update", "number": number})
        while not paper.ended:
            assert await client.call("buses.list", {}, LOCAL)
        assert [message["reason"] async for message in live] == ["slow"]
        await client.close()
        await server.close()

    real(story())


def test_a_plant_that_is_not_there_or_goes_is_said_so_and_found_again(tmp_path: Path) -> None:
    async def story() -> None:
        client = SocketClient(tmp_path / "plant.sock")
        with pytest.raises(ServiceUnavailable):
            await client.call("buses.list", {}, LOCAL)
        for _ in range(2):
            server = SocketServer(Paper(), tmp_path / "plant.sock")
            await server.open()
            assert await client.call("buses.list", {}, LOCAL)
            live = client.live("state", LOCAL)
            waiting = asyncio.create_task(anext(live))  # type: ignore[arg-type]
            await asyncio.sleep(0.05)
            await server.close()
            with pytest.raises(ServiceUnavailable):
                await waiting
        await client.close()

    real(story())


def test_what_is_no_request_ends_the_connection_and_nothing_else(tmp_path: Path) -> None:
    async def story() -> None:
        paper = Paper()
        server, client = SocketServer(paper, tmp_path / "plant.sock"), SocketClient(tmp_path / "plant.sock")
        await server.open()
        for line in (b"hello\n", b'{"id": 1, "op": "plant.stop"}\n', b"[]\n", b'{"id": 1, "actor": {}}\n'):
            reader, writer = await asyncio.open_unix_connection(str(tmp_path / "plant.sock"))
            writer.write(line)
            assert await reader.read() == b""
            writer.close()
        assert paper.asked == []
        assert await client.call("buses.list", {}, LOCAL)
        await client.close()
        await server.close()

    real(story())


def test_only_the_user_that_runs_the_plant_may_open_its_sockets_however_deep_they_lie(tmp_path: Path) -> None:
    async def story() -> None:
        deep = tmp_path / ("d" * 60) / ("e" * 60)
        deep.mkdir(parents=True)
        server, client = SocketServer(Paper(), deep / "plant.sock"), SocketClient(deep / "plant.sock")
        await server.open()
        assert stat.S_IMODE((deep / "plant.sock").stat().st_mode) == 0o600
        assert await client.call("buses.list", {}, LOCAL)
        await client.close()
        await server.close()
        assert not [*deep.iterdir()]

    real(story())


def test_the_stop_socket_takes_nothing_but_stop_all(tmp_path: Path) -> None:
    async def story() -> None:
        paper = Paper()
        server = StopServer(paper, tmp_path / "stop.sock")
        await server.open()
        for line in (b'{"id": 1, "op": "drive.run"}\n', b"start all\n", b""):
            reader, writer = await asyncio.open_unix_connection(str(tmp_path / "stop.sock"))
            writer.write(line)
            writer.write_eof()
            assert await reader.read() == b""
            writer.close()
        assert paper.asked == []
        reader, writer = await asyncio.open_unix_connection(str(tmp_path / "stop.sock"))
        writer.write(b"stop all\n")
        assert await reader.readline() == STOP_RECEIVED, "at once, before anything has stopped"
        assert json.loads(await reader.readline())["operation"] == "plant.stop"
        assert [asked[0] for asked in paper.asked] == ["plant.stop"]
        writer.close()
        await server.close()

    real(story())


def test_the_same_refusals_through_the_socket_as_in_process(tmp_path: Path) -> None:
    """One gate, whatever the door."""

    async def story() -> None:
        async with running_service() as kit:
            server, client = SocketServer(kit.service, tmp_path / "plant.sock"), SocketClient(tmp_path / "plant.sock")
            await server.open()
            viewer = remote_actor(role=Role.VIEWER)
            for kind, operation, params, actor in (
                (PermissionDenied, "drive.stop", {"drive": "fan-1"}, viewer),
                (NotFound, "drives.get", {"drive": "x"}, LOCAL),
                (InvalidParameters, "drive.run", {"drive": "fan-1", "frequency_hz": "1"}, LOCAL),
            ):
                with pytest.raises(kind) as near:
                    await kit.service.call(operation, params, actor)
                with pytest.raises(kind) as far:
                    await client.call(operation, params, actor)
                assert error_to_json(far.value) == error_to_json(near.value)
            await client.close()
            await server.close()

    real(story())


def test_an_error_told_and_raised_again_says_the_same() -> None:
    error = LimitError("drives.above_maximum", frequency_hz=99.0, limit_hz=50.0)
    inner = NotFound("plant.no_drive", id="x")
    for one in (
        error,
        LimitError("drives.not_started", why=inner),
        InvalidParameters("plant.params", faults=[{"a": 1}]),
    ):
        assert error_to_json(error_from_json(error_to_json(one))) == error_to_json(one)
    strange = error_to_json(error) | {"kind": "Exception"}
    assert error_to_json(error_from_json(strange))["code"] == "drives.above_maximum"


def test_a_stop_goes_before_the_questions_that_came_with_it(tmp_path: Path) -> None:
    async def story() -> None:
        paper = Paper()
        server, client = SocketServer(paper, tmp_path / "plant.sock"), SocketClient(tmp_path / "plant.sock")
        await server.open()
        await client.call("plant.get", {}, LOCAL)
        given = ["buses.list"] * 50 + ["waiver.grant", "drive.stop"]
        await asyncio.gather(*(client.call(name, {}, LOCAL) for name in given))
        asked = [operation for operation, _, _ in paper.asked]
        assert len(asked) == 53 and asked.index("drive.stop") < 5
        assert asked.index("waiver.grant") < asked.index("drive.stop")  # no start that comes after its stop
        await client.close()
        await server.close()

    real(story())
