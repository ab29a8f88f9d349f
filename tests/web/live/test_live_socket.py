"""The live connection over a real socket, with the real middleware and a real plant."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
import websockets
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

from drivebus.service.api.operations import API_PREFIX
from drivebus.service.auth.rights import Role
from drivebus.types import Json
from fixtures.running_service import PASSWORD, RunningService, http_service, token

TIMEOUT_S = 30.0


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningService]:
    with http_service(Path(tmp_path_factory.mktemp("plant"))) as found:
        yield found


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
            answers = [await renewed(one) for one in (socket, other)]
        (await program.delete(f"{API_PREFIX}/drives/fan-1/lease")).raise_for_status()
    assert answers[0]["drives"]["fan-1"]["lease"]["owner"] == "operator/test"
    assert answers[1]["drives"]["fan-1"]["error"]["kind"] == "PermissionDenied"


async def renewed(socket: ClientConnection) -> Json:
    await socket.send('{"renew": ["fan-1"]}')
    while (found := await receive(socket))["type"] != "leases":
        pass
    return found
