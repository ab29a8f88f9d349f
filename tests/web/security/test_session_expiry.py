"""A WebSocket ends with the credential that opened it, whatever its route is doing."""

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


class Guest:
    """A visitor whose credential ends when a test says so."""

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


class Line:
    """What came and what was sent."""

    def __init__(self) -> None:
        self.coming: asyncio.Queue[Message] = asyncio.Queue()
        self.sent: list[Message] = []

    async def send(self, message: Any) -> None:
        self.sent.append(message)


def begun(guest: Guest, line: Line, route: Any) -> asyncio.Task[None]:
    async def app(scope: Any, receive: Any, send: Any) -> None:
        await route(receive, send)

    return asyncio.create_task(run_until_credential_ends(app, cast(Credential, guest), {}, line.coming.get, line.send))


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

    async def story() -> None:
        guest, line = Guest(), Line()
        watching = begun(guest, line, route)
        line.coming.put_nowait({"type": "websocket.receive", "text": "a"})
        await asyncio.sleep(1)
        before = list(line.sent)
        assert [one["type"] for one in before] == ["websocket.accept"] * accepted + ["websocket.send"]
        guest.over.set()
        await watching
        assert got == [{"type": "websocket.receive", "text": "a"}, GONE, GONE]
        *text, closed = line.sent[len(before) :]
        assert closed == {"type": "websocket.close", "code": 4401, "reason": "expired"}
        assert [one["type"] for one in text] == ["websocket.send"] * accepted
        for one in text:
            report = json.loads(one["text"])
            assert report == {"type": "closed", "reason": "expired", "text": localized("auth.closed.expired")}
            assert report["text"]["en"] != "auth.closed.expired"
            assert "\\u" not in one["text"], "as short as it can be"

    run(story(), max_s=60.0)


def test_a_route_that_ends_by_itself_ends_the_watching() -> None:
    async def route(receive: Any, send: Any) -> None:
        assert (await receive())["type"] == "websocket.disconnect"
        await send({"type": "websocket.close", "code": 1000})

    async def story() -> None:
        guest, line = Guest(), Line()
        watching = begun(guest, line, route)
        line.coming.put_nowait({"type": "websocket.disconnect", "code": 1000})
        await watching
        assert line.sent == [{"type": "websocket.close", "code": 1000}] and guest.let_go

    run(story(), max_s=60.0)


def test_a_route_that_fails_fails_outside_too() -> None:
    async def route(receive: Any, send: Any) -> None:
        raise ZeroDivisionError

    async def story() -> None:
        guest = Guest()
        with pytest.raises(ZeroDivisionError):
            await begun(guest, Line(), route)
        assert guest.let_go

    run(story(), max_s=60.0)


def test_cancelling_the_connection_cancels_its_route() -> None:
    """The server goes: nothing is left running behind it."""
    ends: list[str] = []

    async def route(receive: Any, send: Any) -> None:
        try:
            await receive()
        except asyncio.CancelledError:
            ends.append("route")
            raise

    async def story() -> None:
        guest, line = Guest(), Line()
        watching = begun(guest, line, route)
        await asyncio.sleep(1)
        watching.cancel()
        with pytest.raises(asyncio.CancelledError):
            await watching
        await asyncio.sleep(1)
        assert ends == ["route"] and guest.let_go
        assert len(asyncio.all_tasks()) == 1, "what was waited for is let go, too"

    run(story(), max_s=60.0)


def test_what_the_route_does_not_wait_for_any_more_is_let_go() -> None:
    """A message that comes after the end is for nobody, and one that was waited for keeps no task."""

    async def route(receive: Any, send: Any) -> None:
        for _ in range(3):
            await receive()

    async def story() -> None:
        guest, line = Guest(), Line()
        watching = begun(guest, line, route)
        for _ in range(2):
            line.coming.put_nowait({"type": "websocket.receive", "text": "a"})
            await asyncio.sleep(0.1)
            assert len(asyncio.all_tasks()) == 6, "this one, three of the watching, two of the waiting"
        guest.over.set()
        await watching
        await asyncio.sleep(0.1)
        assert len(asyncio.all_tasks()) == 1

    run(story(), max_s=60.0)
