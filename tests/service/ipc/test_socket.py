"""Sockets of the service: the same answers as in its process, no request delays a stop, file mode 0600."""

from __future__ import annotations

import asyncio
import json
import stat
import time
from collections.abc import AsyncIterator, Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest

from drivebus.drives.permissives import CommandKind
from drivebus.drives.state import Direction, DriveState
from drivebus.errors import (
    Expired,
    InvalidParameters,
    LimitError,
    NotFound,
    PermissionDenied,
    ServiceUnavailable,
    StartInhibited,
)
from drivebus.service.api.errors import error_from_json, error_to_json
from drivebus.service.auth.actor import Actor
from drivebus.service.auth.rights import Role
from drivebus.service.ipc import client as client_module
from drivebus.service.ipc import server as server_module
from drivebus.service.ipc.client import MAX_UNREAD_LIVE_BYTES, SocketClient
from drivebus.service.ipc.protocol import STOP_RECEIVED
from drivebus.service.ipc.server import MAX_CONCURRENT_REQUESTS, SocketServer, StopServer, _ClientConnection
from drivebus.types import Json
from fixtures.service import LOCAL, remote_actor, running_service


def real(coroutine: Coroutine[Any, Any, None]) -> None:
    """Run in a real event loop: virtual time has no sockets."""
    asyncio.run(coroutine)


async def until(condition: Callable[[], bool]) -> None:
    """Wait up to ten seconds for what another task does."""
    for _ in range(2000):
        if condition():
            return
        await asyncio.sleep(0.005)
    raise AssertionError("the condition did not become true")


HALL_OF_300_DRIVES = "x" * 300 * 2500
"""In the place of topics: as long as the objects of 300 drives."""


class ScriptedService:
    """Service that answers from a script. ``drives.list`` waits for ``released``; live messages are those queued."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, Json, Actor]] = []
        self.records: list[Json] = []
        self.released = asyncio.Event()
        self.messages: asyncio.Queue[Json] = asyncio.Queue()
        self.ended = 0
        self.ended_sessions: list[tuple[str, str]] = []

    async def call(self, operation: str, params: Json, actor: Actor) -> Json:
        self.calls.append((operation, params, actor))
        if operation == "drives.list":
            await self.released.wait()
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
        self.records.append(entry)

    async def end_control(self, reason: str, actor: Actor) -> None:
        self.ended_sessions.append((reason, actor.session))


def test_the_end_of_a_session_carries_its_reason_and_its_session(tmp_path: Path) -> None:
    async def scenario() -> None:
        service = ScriptedService()
        server, client = SocketServer(service, tmp_path / "plant.sock"), SocketClient(tmp_path / "plant.sock")
        await server.open()
        await client.end_control("logout", remote_actor())
        assert service.ended_sessions == [("logout", "session-ann")]
        await client.close()
        await server.close()

    asyncio.run(scenario())


def test_a_call_carries_its_actor_and_returns_the_whole_error(tmp_path: Path) -> None:
    async def scenario() -> None:
        service = ScriptedService()
        server, client = SocketServer(service, tmp_path / "plant.sock"), SocketClient(tmp_path / "plant.sock")
        await server.open()
        ann = remote_actor()
        assert (await client.call("buses.list", {"a": 1}, ann))["operation"] == "buses.list"
        assert service.calls == [("buses.list", {"a": 1}, ann)]
        with pytest.raises(LimitError) as rejected:
            await client.call("drive.run", {}, ann)
        assert rejected.value.params == {"frequency_hz": 99.0, "limit_hz": 50.0}
        await client.record({"what": "login"}, ann)
        assert service.records == [{"what": "login"}]
        await client.close()
        await server.close()

    real(scenario())


def test_a_stop_is_answered_while_a_thousand_requests_wait(tmp_path: Path) -> None:
    """A further request is rejected as too busy."""

    async def scenario() -> None:
        service = ScriptedService()
        server, client = SocketServer(service, tmp_path / "plant.sock"), SocketClient(tmp_path / "plant.sock")
        await server.open()
        hanging = [asyncio.create_task(client.call("drives.list", {}, LOCAL)) for _ in range(MAX_CONCURRENT_REQUESTS)]
        await until(lambda: len(service.calls) == MAX_CONCURRENT_REQUESTS)
        with pytest.raises(ServiceUnavailable):
            await client.call("drives.list", {}, LOCAL)
        assert (await client.call("plant.stop", {}, LOCAL))["operation"] == "plant.stop"
        service.released.set()
        await asyncio.gather(*hanging)
        await client.close()
        await server.close()

    real(scenario())


def test_the_end_of_a_client_cancels_its_live_streams_and_no_command(tmp_path: Path) -> None:
    async def scenario() -> None:
        service = ScriptedService()
        server, client = SocketServer(service, tmp_path / "plant.sock"), SocketClient(tmp_path / "plant.sock")
        await server.open()
        listening = asyncio.create_task(anext(client.live("state", LOCAL)))
        service.messages.put_nowait({"type": "snapshot"})
        assert (await listening)["type"] == "snapshot"
        pending = asyncio.create_task(client.call("drives.list", {}, LOCAL))
        await until(lambda: bool(service.calls))
        await client.close()
        with pytest.raises(ServiceUnavailable):
            await pending
        await until(lambda: bool(service.ended))
        service.released.set()
        await server.close()

    real(scenario())


async def opened_live_stream(service: ScriptedService, client: SocketClient) -> AsyncIterator[Json]:
    live = client.live("state", LOCAL)
    service.messages.put_nowait({"type": "snapshot"})
    assert (await anext(live))["type"] == "snapshot"
    return live


def test_a_slow_reader_of_live_values_is_closed_with_the_reason_and_delays_no_request(tmp_path: Path) -> None:
    async def scenario() -> None:
        service = ScriptedService()
        server, client = SocketServer(service, tmp_path / "plant.sock"), SocketClient(tmp_path / "plant.sock")
        await server.open()
        live = await opened_live_stream(service, client)
        for number in range(MAX_UNREAD_LIVE_BYTES // len(HALL_OF_300_DRIVES) + 2):
            service.messages.put_nowait({"type": "update", "number": number, "topics": HALL_OF_300_DRIVES})
        while not service.ended:
            assert await client.call("buses.list", {}, LOCAL)
        assert [message["reason"] async for message in live] == ["slow"]
        await client.close()
        await server.close()

    real(scenario())


def test_a_reader_that_pauses_while_300_drives_change_gets_every_message(tmp_path: Path) -> None:
    """Three changes of each drive, one in a message, as after a page's pause of a second."""

    async def scenario() -> None:
        service = ScriptedService()
        server, client = SocketServer(service, tmp_path / "plant.sock"), SocketClient(tmp_path / "plant.sock")
        await server.open()
        live = await opened_live_stream(service, client)
        for number in range(900):
            service.messages.put_nowait({"type": "update", "number": number, "topics": "x" * 2500})
        await until(service.messages.empty)
        assert await client.call("buses.list", {}, LOCAL)
        assert [(await anext(live))["number"] for _ in range(900)] == [*range(900)]
        assert not service.ended
        await live.aclose()  # type: ignore[attr-defined]
        await client.close()
        await server.close()

    real(scenario())


def test_a_missing_or_ended_service_is_reported_and_a_new_one_is_connected(tmp_path: Path) -> None:
    async def scenario() -> None:
        client = SocketClient(tmp_path / "plant.sock")
        with pytest.raises(ServiceUnavailable):
            await client.call("buses.list", {}, LOCAL)
        for _ in range(2):
            server = SocketServer(ScriptedService(), tmp_path / "plant.sock")
            await server.open()
            assert await client.call("buses.list", {}, LOCAL)
            live = client.live("state", LOCAL)
            waiting = asyncio.create_task(anext(live))
            await asyncio.sleep(0.05)
            await server.close()
            with pytest.raises(ServiceUnavailable):
                await waiting
        await client.close()

    real(scenario())


def test_an_invalid_request_ends_its_own_connection_only(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    async def scenario() -> None:
        service = ScriptedService()
        server, client = SocketServer(service, tmp_path / "plant.sock"), SocketClient(tmp_path / "plant.sock")
        await server.open()
        actor = json.dumps(LOCAL.as_json())
        twice = f'{{"id": 1, "op": "plant.stop", "op": "drive.run", "params": {{}}, "actor": {actor}}}\n'
        no_number = f'{{"id": 1, "op": "drive.run", "params": {{"frequency_hz": NaN}}, "actor": {actor}}}\n'
        invalid = (b"hello\n", b'{"id": 1, "op": "plant.stop"}\n', b"[]\n", b'{"id": 1, "actor": {}}\n')
        too_large = f'{{"id": 1, "op": "drive.run", "called_at": 1{"0" * 400}, "actor": {actor}}}\n'
        no_times = [
            f'{{"id": 1, "op": "drive.run", "called_at": {value}, "actor": {actor}}}\n'
            for value in ('"nan"', '"1e9"', "true", "null")
        ]
        texts = (twice, no_number, too_large, *no_times)
        for line in (*invalid, *(text.encode() for text in texts), b"[" * 100_000 + b"\n"):
            reader, writer = await asyncio.open_unix_connection(str(tmp_path / "plant.sock"))
            writer.write(line)
            assert await reader.read() == b""
            writer.close()
        assert service.calls == []
        assert {record.levelname for record in caplog.records} == {"WARNING"}, "none is an error of this program"
        assert await client.call("buses.list", {}, LOCAL)
        await client.close()
        await server.close()

    real(scenario())


def test_only_the_user_of_the_service_may_open_its_sockets_also_at_a_long_path(tmp_path: Path) -> None:
    async def scenario() -> None:
        deep = tmp_path / ("d" * 60) / ("e" * 60)
        deep.mkdir(parents=True)
        server, client = SocketServer(ScriptedService(), deep / "plant.sock"), SocketClient(deep / "plant.sock")
        await server.open()
        assert stat.S_IMODE((deep / "plant.sock").stat().st_mode) == 0o600
        assert await client.call("buses.list", {}, LOCAL)
        await client.close()
        await server.close()
        assert not [*deep.iterdir()]

    real(scenario())


def test_the_stop_socket_accepts_nothing_but_stop_all(tmp_path: Path) -> None:
    async def scenario() -> None:
        service = ScriptedService()
        server = StopServer(service, tmp_path / "stop.sock")
        await server.open()
        for line in (b'{"id": 1, "op": "drive.run"}\n', b"start all\n", b""):
            reader, writer = await asyncio.open_unix_connection(str(tmp_path / "stop.sock"))
            writer.write(line)
            writer.write_eof()
            assert await reader.read() == b""
            writer.close()
        assert service.calls == []
        reader, writer = await asyncio.open_unix_connection(str(tmp_path / "stop.sock"))
        writer.write(b"stop all\n")
        assert await reader.readline() == STOP_RECEIVED, "at once, before anything has stopped"
        assert json.loads(await reader.readline())["operation"] == "plant.stop"
        assert [operation for operation, _, _ in service.calls] == ["plant.stop"]
        writer.close()
        await server.close()

    real(scenario())


def test_a_stop_of_everything_that_reaches_an_ended_service_has_no_outcome_and_logs_no_traceback(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """The service has ended, and its sockets are still open for a moment."""

    async def scenario() -> None:
        async with running_service() as kit:
            server = StopServer(kit.service, tmp_path / "stop.sock")
            await server.open()
            await kit.service.stop()
            reader, writer = await asyncio.open_unix_connection(str(tmp_path / "stop.sock"))
            writer.write(b"stop all\n")
            assert await reader.read() == STOP_RECEIVED
            writer.close()
            await server.close()

    real(scenario())
    assert [record for record in caplog.records if record.exc_info] == []


def test_the_socket_returns_the_same_errors_as_the_service_in_process(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            server, client = SocketServer(kit.service, tmp_path / "plant.sock"), SocketClient(tmp_path / "plant.sock")
            await server.open()
            viewer = remote_actor(role=Role.VIEWER)
            for kind, operation, params, actor in (
                (PermissionDenied, "drive.stop", {"drive": "fan-1"}, viewer),
                (NotFound, "drives.get", {"drive": "x"}, LOCAL),
                (InvalidParameters, "drive.run", {"drive": "fan-1", "frequency_hz": "1"}, LOCAL),
            ):
                with pytest.raises(kind) as in_process:
                    await kit.service.call(operation, params, actor)
                with pytest.raises(kind) as over_socket:
                    await client.call(operation, params, actor)
                assert error_to_json(over_socket.value) == error_to_json(in_process.value)
            await client.close()
            await server.close()

    real(scenario())


def test_an_error_keeps_its_content_through_json() -> None:
    error = LimitError("drives.above_maximum", frequency_hz=99.0, limit_hz=50.0)
    inner = NotFound("plant.no_drive", id="x")
    for sent in (
        error,
        LimitError("drives.not_started", why=inner),
        InvalidParameters("plant.params", faults=[{"a": 1}]),
        StartInhibited("drives.state_forbids", state=DriveState.STOPPED, kind=CommandKind.RAMP_HOLD),
        StartInhibited("drives.turning", state=DriveState.DECELERATING, direction=Direction.REVERSE),
    ):
        assert error_to_json(error_from_json(error_to_json(sent))) == error_to_json(sent)
    unknown = error_to_json(error) | {"kind": "Exception"}
    assert error_to_json(error_from_json(unknown))["code"] == "drives.above_maximum"


def test_a_stop_is_called_before_the_queries_sent_with_it(tmp_path: Path) -> None:
    async def scenario() -> None:
        service = ScriptedService()
        server, client = SocketServer(service, tmp_path / "plant.sock"), SocketClient(tmp_path / "plant.sock")
        await server.open()
        await client.call("plant.get", {}, LOCAL)
        operations = ["buses.list"] * 50 + ["waiver.grant", "drive.stop"]
        await asyncio.gather(*(client.call(name, {}, LOCAL) for name in operations))
        called = [operation for operation, _, _ in service.calls]
        assert len(called) == 53 and called.index("drive.stop") < 5
        assert called.index("waiver.grant") < called.index("drive.stop")  # no start that comes after its stop
        await client.close()
        await server.close()

    real(scenario())


def test_a_request_to_a_service_that_hangs_ends_and_a_long_one_does_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(client_module, "PING_INTERVAL_S", 0.02)
    monkeypatch.setattr(client_module, "SILENCE_LIMIT_S", 0.2)

    async def hang(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read()
        writer.close()

    async def scenario() -> None:
        service = ScriptedService()
        server = SocketServer(service, tmp_path / "plant.sock")
        await server.open()
        client = SocketClient(server.path)
        long = asyncio.create_task(client.call("drives.list", {}, LOCAL))
        await asyncio.wait({long}, timeout=0.5)
        assert not long.done()
        service.released.set()
        assert (await long)["operation"] == "drives.list"
        await client.close()
        await server.close()
        hanging = await asyncio.start_unix_server(hang, tmp_path / "hangs.sock")
        client = SocketClient(tmp_path / "hangs.sock")
        for _ in range(2):
            with pytest.raises(ServiceUnavailable) as caught:
                await asyncio.wait_for(client.call("drive.run", {}, LOCAL), 5.0)
            assert caught.value.key == "plant.hangs"
        await client.close()
        hanging.close()

    real(scenario())


def test_a_motion_that_waited_for_a_suspended_service_is_not_done_and_a_stop_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A motor must not start seconds after the answer that the service hangs."""
    monkeypatch.setattr(server_module, "MAX_MOTION_WAIT_S", 0.2, raising=False)

    async def scenario() -> None:
        service = ScriptedService()
        server, client = SocketServer(service, tmp_path / "plant.sock"), SocketClient(tmp_path / "plant.sock")
        await server.open()
        await client.call("plant.get", {}, LOCAL)
        operations = ("drive.run", "drive.jog", "drive.set_frequency", "group.start", "drive.stop", "lease.renew")
        calls = [asyncio.create_task(client.call(name, {}, LOCAL)) for name in operations]
        await asyncio.sleep(0)  # each is written
        time.sleep(0.3)  # noqa: ASYNC251  the process of the service is suspended
        *motions, stop, renewal = await asyncio.gather(*calls, return_exceptions=True)
        assert [type(result) for result in motions] == [Expired] * 4
        assert {result.key for result in motions if isinstance(result, Expired)} == {"plant.waited_too_long"}
        assert not isinstance(stop, Exception) and not isinstance(renewal, Exception)
        assert [name for name, _, _ in service.calls] == ["plant.get", "drive.stop", "lease.renew"]
        assert (await client.call("drive.set_frequency", {}, LOCAL))["operation"] == "drive.set_frequency"
        await client.close()
        await server.close()

    real(scenario())


def test_the_end_of_a_session_does_not_disconnect_from_a_service_that_does_not_know_the_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    present = _ClientConnection._dispatch

    def dispatch_of_before(self: Any, message: Json, actor: Actor) -> Any:
        return present(self, {name: value for name, value in message.items() if name != "end_control"}, actor)

    async def scenario() -> None:
        monkeypatch.setattr(_ClientConnection, "_dispatch", dispatch_of_before)
        async with running_service() as kit:
            server, client = SocketServer(kit.service, tmp_path / "plant.sock"), SocketClient(tmp_path / "plant.sock")
            await server.open()
            with pytest.raises(NotFound):
                await client.end_control("logout", remote_actor())
            assert client._writer is not None
            await client.close()
            await server.close()

    real(scenario())
