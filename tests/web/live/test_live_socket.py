"""The live connection over a real socket, with the real middleware and a real plant."""

from __future__ import annotations

import asyncio
import json

import httpx
import pytest
import websockets
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

from drivebus.service.api.operations import API_PREFIX
from drivebus.service.auth.rights import Role
from drivebus.types import Json
from fixtures.running_service import PASSWORD, RunningService, plant_fixture, token

TIMEOUT_S = 30.0


plant = plant_fixture()


def live(plant: RunningService, query: str = "", **headers: str) -> connect:
    address = f"{plant.url.replace('http', 'ws')}{API_PREFIX}/live{query}"
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    return connect(address, additional_headers=named, compression=None)


def by_token(plant: RunningService, query: str = "", role: Role = Role.VIEWER) -> connect:
    return live(plant, query, Authorization=f"Bearer {token(role)}")


async def receive(socket: ClientConnection) -> Json:
    message: Json = json.loads(await asyncio.wait_for(socket.recv(), TIMEOUT_S))
    return message


async def ended(socket: ClientConnection) -> tuple[Json, int]:
    """Return the last message and the close code."""
    last: Json = {}
    try:
        while True:
            last = await receive(socket)
    except ConnectionClosed as closed:
        return last, closed.rcvd.code if closed.rcvd else 0


async def test_a_snapshot_is_followed_by_deltas_of_the_requested_topics(plant: RunningService) -> None:
    async with by_token(plant, "?topics=drives/fan-*,plant&interval=0.1") as socket:
        first = await receive(socket)
        assert (first["type"], sorted(first["topics"])) == ("snapshot", ["drives/fan-1", "drives/fan-2", "plant"])
        while not (later := await receive(socket))["topics"]:
            pass
        assert (later["type"], set(later["topics"]) <= set(first["topics"])) == ("delta", True)


async def test_text_that_is_not_utf_8_ends_the_connection_without_a_traceback_in_the_log(
    plant: RunningService, caplog: pytest.LogCaptureFixture
) -> None:
    async with by_token(plant) as socket:
        await socket.send(b"\xff\xfe", text=True)
        _, code = await ended(socket)
    assert (code, [record for record in caplog.records if record.exc_info]) == (1007, [])


@pytest.mark.parametrize(
    "more",
    [
        "?topics=" + "a" * 8_200,
        " HTTP/1.1\r\nX: " + "a" * 9_000,
        " HTTP/1.1" + "\r\nX: y" * 200,
        " HTTP/1.1\r\nX: \x7f",
    ],
    ids=["a long address", "a long header", "many headers", "a control character"],
)
async def test_a_handshake_that_is_too_long_or_no_request_is_ended_at_once(plant: RunningService, more: str) -> None:
    """It stayed open without an answer: 576 of them, without a login, kept everybody from the page."""
    host, port = plant.url.removeprefix("http://").split(":")
    reader, writer = await asyncio.open_connection(host, int(port))
    upgrade = "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAA\r\n"
    request = f"GET {API_PREFIX}/live{more}{'' if 'HTTP' in more else ' HTTP/1.1'}\r\nHost: {host}\r\n{upgrade}\r\n"
    writer.write(request.encode())
    async with asyncio.timeout(5):
        answer = await reader.read()
    writer.close()
    assert answer[:12] in (b"HTTP/1.1 414", b"HTTP/1.1 431", b"HTTP/1.1 400", b"")


@pytest.mark.parametrize("requests", [1, 2])
async def test_a_handshake_behind_a_request_without_response_ends_the_connection_with_that_response(
    plant: RunningService, requests: int
) -> None:
    """The snapshot came before or after the response, and the WebSocket ended 15 s later as an idle connection."""
    host, port = plant.url.removeprefix("http://").split(":")
    reader, writer = await asyncio.open_connection(host, int(port))
    upgrade = "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
    key = f"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nAuthorization: Bearer {token(Role.VIEWER)}\r\n"
    first = f"GET {API_PREFIX}/session HTTP/1.1\r\nHost: {host}\r\n\r\n" * requests
    writer.write(f"{first}GET {API_PREFIX}/live HTTP/1.1\r\nHost: {host}\r\n{upgrade}{key}\r\n".encode())
    async with asyncio.timeout(5):
        answer = await reader.read()
    writer.close()
    assert (answer.count(b"HTTP/1.1 "), answer.count(b"HTTP/1.1 101")) == (requests, 0), answer[:500]


async def test_a_denied_handshake_is_no_error_in_the_log(
    plant: RunningService, caplog: pytest.LogCaptureFixture
) -> None:
    """Anyone could fill the log with the error "without completing handshake"."""
    with pytest.raises(InvalidStatus) as denied:
        async with live(plant, Authorization="Bearer unknown"):
            pass
    assert denied.value.response.status_code == 401
    async with by_token(plant) as socket:  # by now the server has ended the other one
        await receive(socket)
    assert [record.message for record in caplog.records if record.levelname == "ERROR"] == []


async def test_frames_are_sent_while_they_are_subscribed(plant: RunningService) -> None:
    async with by_token(plant, "?topics=frames/a") as socket:
        while not (frames := (await receive(socket))["topics"].get("frames/a")):
            pass
        assert {"n", "kind", "hex", "text", "station"} <= frames[0].keys()


async def test_a_logout_ends_the_connection_at_once(plant: RunningService) -> None:
    async with httpx.AsyncClient(base_url=plant.url) as browser:
        given = {"name": "operator", "password": PASSWORD}
        answer = (await browser.post(f"{API_PREFIX}/login", json=given)).raise_for_status()
        cookie = f"drivebus_session={answer.cookies['drivebus_session']}"
        async with live(plant, Cookie=cookie, Origin=plant.url) as socket:
            assert (await receive(socket))["type"] == "snapshot"
            await browser.post(f"{API_PREFIX}/logout", json={}, headers={"X-Drivebus-CSRF": answer.json()["csrf"]})
            last, code = await ended(socket)
    assert (last["type"], last["reason"], code) == ("closed", "logout", 4401)


async def test_a_refused_handshake_has_the_status_and_the_error_of_any_request(plant: RunningService) -> None:
    """A program whose token has expired would look for a missing right after a bare 403."""
    with pytest.raises(InvalidStatus) as refused:
        await live(plant, Authorization="Bearer dbt_unknown")
    response = refused.value.response
    assert (response.status_code, response.headers["Content-Type"]) == (401, "application/json")
    assert json.loads(response.body)["error"]["code"] == "auth.not_logged_in"


@pytest.mark.parametrize("origin", [None, "null", "http://evil.example", "http://127.0.0.1.evil.example"])
async def test_a_foreign_page_cannot_connect(plant: RunningService, origin: str | None) -> None:
    async with httpx.AsyncClient(base_url=plant.url) as browser:
        answer = await browser.post(f"{API_PREFIX}/login", json={"name": "viewer", "password": PASSWORD})
    headers = {"Cookie": f"drivebus_session={answer.cookies['drivebus_session']}"}
    headers |= {"Origin": origin} if origin is not None else {}
    with pytest.raises(InvalidStatus) as refused:
        await live(plant, **headers)
    assert refused.value.response.status_code == 403, "accepted with the right origin"
    async with live(plant, **headers | {"Origin": plant.url}) as socket:
        assert (await receive(socket))["type"] == "snapshot"


@pytest.mark.parametrize("text", ["{}", '{"run": ["fan-1"]}', b"\x00"])
async def test_a_malformed_message_ends_the_connection_with_the_reason(
    plant: RunningService, text: str | bytes
) -> None:
    async with by_token(plant) as socket:
        await socket.send(text)
        last, code = await ended(socket)
    assert (last["reason"], code) == ("bad_message", 4400)


async def test_an_oversized_message_ends_the_connection(plant: RunningService) -> None:
    async with by_token(plant) as socket:
        await socket.send('{"subscribe": ["' + "a" * 200_000 + '"]}')
        _, code = await ended(socket)
    assert code == websockets.CloseCode.MESSAGE_TOO_BIG


async def test_a_lease_is_renewed_by_its_owner_over_the_connection(plant: RunningService) -> None:
    headers = {"Authorization": f"Bearer {token(Role.OPERATOR)}"}
    async with httpx.AsyncClient(base_url=plant.url, headers=headers) as program:
        (await program.post(f"{API_PREFIX}/drives/fan-1/lease")).raise_for_status()
        async with (
            by_token(plant, "?topics=alarms", Role.OPERATOR) as socket,
            by_token(plant, "?topics=alarms") as other,
        ):
            answers = [await renewed(connection) for connection in (socket, other)]
        (await program.delete(f"{API_PREFIX}/drives/fan-1/lease")).raise_for_status()
    assert answers[0]["drives"]["fan-1"]["lease"]["owner"] == "operator/test"
    assert answers[1]["drives"]["fan-1"]["error"]["kind"] == "PermissionDenied"


async def renewed(socket: ClientConnection) -> Json:
    await socket.send('{"renew": ["fan-1"]}')
    while (found := await receive(socket))["type"] != "leases":
        pass
    return found
