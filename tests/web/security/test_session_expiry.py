"""A WebSocket ends with the credential that opened it, independent of its route."""

from __future__ import annotations

import asyncio
import json
from typing import Any, cast

import pytest

from drivebus.service.api.errors import localized
from drivebus.service.auth.credentials import Credential
from drivebus.testing.virtual_time import run
from drivebus.web.middleware.session_expiry import run_until_credential_ends

Message = dict[str, Any]
GONE = {"type": "websocket.disconnect", "code": 4401}


class FakeCredential:
    """A credential that ends when a test ends it."""

    def __init__(self) -> None:
        self.over = asyncio.Event()
        self.let_go = False

    async def wait_ended(self) -> str:
        try:
            await self.over.wait()
        except asyncio.CancelledError:
            self.let_go = True
            raise
        return "expired"


class FakeConnection:
    """An ASGI connection: received and sent messages."""

    def __init__(self) -> None:
        self.coming: asyncio.Queue[Message] = asyncio.Queue()
        self.sent: list[Message] = []

    async def send(self, message: Any) -> None:
        self.sent.append(message)


def begun(credential: FakeCredential, line: FakeConnection, route: Any) -> asyncio.Task[None]:
    async def app(scope: Any, receive: Any, send: Any) -> None:
        await route(receive, send)

    return asyncio.create_task(
        run_until_credential_ends(app, cast(Credential, credential), {}, line.coming.get, line.send)
    )


@pytest.mark.parametrize("accepted", [True, False])
def test_an_ended_credential_closes_with_a_reason_and_disconnects_the_route(accepted: bool) -> None:
    got: list[Message] = []

    async def route(receive: Any, send: Any) -> None:
        if accepted:
            await send({"type": "websocket.accept"})
        while (message := await receive())["type"] != "websocket.disconnect":
            got.append(message)
            await send({"type": "websocket.send", "text": "echo"})
        got.append(message)
        got.append(await receive())
        await send({"type": "websocket.send", "text": "something of the plant"})

    async def scenario() -> None:
        credential, line = FakeCredential(), FakeConnection()
        watching = begun(credential, line, route)
        line.coming.put_nowait({"type": "websocket.receive", "text": "a"})
        await asyncio.sleep(1)
        before = list(line.sent)
        assert [message["type"] for message in before] == ["websocket.accept"] * accepted + ["websocket.send"]
        credential.over.set()
        await watching
        assert got == [{"type": "websocket.receive", "text": "a"}, GONE, GONE]
        *text, closed = line.sent[len(before) :]
        assert closed == {"type": "websocket.close", "code": 4401, "reason": "expired"}
        assert [message["type"] for message in text] == ["websocket.send"] * accepted
        for message in text:
            report = json.loads(message["text"])
            assert report == {"type": "closed", "reason": "expired", "text": localized("auth.closed.expired")}
            assert report["text"]["en"] != "auth.closed.expired"
            assert "\\u" not in message["text"], "as short as it can be"

    run(scenario(), max_s=60.0)


def test_a_route_that_ends_by_itself_ends_the_supervision() -> None:
    async def route(receive: Any, send: Any) -> None:
        assert (await receive())["type"] == "websocket.disconnect"
        await send({"type": "websocket.close", "code": 1000})

    async def scenario() -> None:
        credential, line = FakeCredential(), FakeConnection()
        watching = begun(credential, line, route)
        line.coming.put_nowait({"type": "websocket.disconnect", "code": 1000})
        await watching
        assert line.sent == [{"type": "websocket.close", "code": 1000}] and credential.let_go

    run(scenario(), max_s=60.0)


def test_a_failure_of_the_route_is_raised() -> None:
    async def route(receive: Any, send: Any) -> None:
        raise ZeroDivisionError

    async def scenario() -> None:
        credential = FakeCredential()
        with pytest.raises(ZeroDivisionError):
            await begun(credential, FakeConnection(), route)
        assert credential.let_go

    run(scenario(), max_s=60.0)


def test_cancelling_the_connection_cancels_its_route() -> None:
    """No task keeps running when the server ends."""
    ends: list[str] = []

    async def route(receive: Any, send: Any) -> None:
        try:
            await receive()
        except asyncio.CancelledError:
            ends.append("route")
            raise

    async def scenario() -> None:
        credential, line = FakeCredential(), FakeConnection()
        watching = begun(credential, line, route)
        await asyncio.sleep(1)
        watching.cancel()
        with pytest.raises(asyncio.CancelledError):
            await watching
        await asyncio.sleep(1)
        assert ends == ["route"] and credential.let_go
        assert len(asyncio.all_tasks()) == 1, "what was waited for is let go, too"

    run(scenario(), max_s=60.0)


def test_messages_after_the_end_of_the_route_are_dropped() -> None:
    """A message after the end is ignored, and a pending receive leaves no task."""

    async def route(receive: Any, send: Any) -> None:
        for _ in range(3):
            await receive()

    async def scenario() -> None:
        credential, line = FakeCredential(), FakeConnection()
        watching = begun(credential, line, route)
        for _ in range(2):
            line.coming.put_nowait({"type": "websocket.receive", "text": "a"})
            await asyncio.sleep(0.1)
            assert len(asyncio.all_tasks()) == 6, "this one, three of the watching, two of the waiting"
        credential.over.set()
        await watching
        await asyncio.sleep(0.1)
        assert len(asyncio.all_tasks()) == 1

    run(scenario(), max_s=60.0)
