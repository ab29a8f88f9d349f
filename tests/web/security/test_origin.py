"""Requests that a foreign page sends through a browser have no effect; a connection ends with its session."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest

from drivebus.testing.virtual_time import run
from drivebus.web.app import declared_routes
from drivebus.web.gateway import WebConfig
from drivebus.web.route import WEBSOCKET
from fixtures.web_app import BASE, AppWebSocket, WebAppHarness

CHANGING = [entry for entry in declared_routes() if entry.method not in ("GET", WEBSOCKET)]
FOREIGN = [
    "http://evil.example",
    "null",
    "",
    "http://127.0.0.1:8080.evil.example",
    "http://127.0.0.1:80800",
    "http://127.0.0.1:8081",
    "https://127.0.0.1:8080",
    "http://127.0.0.1",
    "http://evil.example/http://127.0.0.1:8080",
    "http://127.0.0.1:8080@evil.example",
    "file://",
]
FORMS: dict[str, dict[str, Any]] = {
    "a form": {"data": {"frequency_hz": "50"}},
    "a form with files": {"files": {"frequency_hz": ("x", b"50")}},
    "text that is JSON": {"content": '{"frequency_hz": 50}', "headers": {"content-type": "text/plain"}},
    "JSON": {"json": {"frequency_hz": 50}},
    "no body": {},
}


def effects(harness: WebAppHarness) -> list[Any]:
    return harness.service.calls


@pytest.mark.parametrize("form", FORMS)
def test_a_cookie_alone_changes_nothing(form: str, tmp_path: Path) -> None:
    """A foreign page's form, fetch or link sends the cookie, but not the CSRF token."""
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client = await harness.log_in("administrator")
        del client.headers["X-Drivebus-CSRF"]
        before = harness.auth.database
        for entry in CHANGING:
            if "log" in entry.path or "setup" in entry.path:
                continue
            for origin in ({"origin": "http://evil.example"}, {"origin": "null"}, {}):
                more = FORMS[form] | {"headers": FORMS[form].get("headers", {}) | origin}
                answer = await client.request(entry.method, entry.path.replace("{drive}", "fan-1"), **more)
                assert answer.status_code == 403, (entry, origin, answer.text)
        assert effects(harness) == [] and harness.auth.database == before

    run(scenario())


@pytest.mark.parametrize("origin", FOREIGN)
def test_a_foreign_origin_changes_nothing_even_with_everything_else(origin: str, tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client = await harness.log_in("administrator")
        token = await harness.token("administrator", "view", "stop", "operate")
        for entry in CHANGING:
            for more in ({}, {"authorization": f"Bearer {token}"}):
                answer = await client.request(entry.method, entry.path, headers={"origin": origin, **more})
                assert answer.status_code == 403, (entry, answer.text)
        assert effects(harness) == []
        own = await client.post("/api/v1/stop", headers={"origin": BASE})
        assert own.status_code == 200 and len(effects(harness)) == 1

    run(scenario())


@pytest.mark.parametrize("path", ["/api/v1/login", "/api/v1/setup", "/api/v1/login/code"])
def test_a_foreign_page_cannot_log_a_user_in(path: str, tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        body = {"name": "operator", "password": "correct horse battery"}
        for headers in ({"origin": "http://evil.example"}, {"origin": "null"}):
            assert (await harness.client().post(path, json=body, headers=headers)).status_code == 403
        form = await harness.client().post(path, data=body)
        text = await harness.client().post(path, content=json.dumps(body), headers={"content-type": "text/plain"})
        assert (form.status_code, text.status_code) == (415, 415)
        assert harness.auth.sessions.of_user("operator") == []

    run(scenario())


@pytest.mark.parametrize("kind", ["text/plain", "application/x-www-form-urlencoded", "", "application/json-patch+json"])
def test_only_json_is_read_also_from_our_own_page(kind: str, tmp_path: Path) -> None:
    """A form cannot send JSON: a browser sends it to another origin only after a preflight request."""
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client = await harness.log_in("operator")
        for headers in ({"content-type": kind}, {"content-type": "application/json", "content-encoding": "gzip"}):
            answer = await client.post("/api/v1/drives/fan-1/run", content='{"frequency_hz": 50}', headers=headers)
            assert answer.status_code == 415
        assert effects(harness) == []

    run(scenario())


@pytest.mark.parametrize("method", ["GET", "HEAD", "OPTIONS", "TRACE", "FOO"])
def test_no_other_method_reaches_a_command(method: str, tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client = await harness.log_in("administrator")
        readable = {entry.path for entry in declared_routes() if entry.method == "GET"}
        for entry in CHANGING:
            if entry.path in readable and method in ("GET", "HEAD"):
                continue
            answer = await client.request(method, entry.path, headers={"x-http-method-override": entry.method})
            assert answer.status_code == 405, (entry, answer.status_code)
            assert "access-control-allow-origin" not in answer.headers
        assert effects(harness) == []

    run(scenario())


@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("127.0.0.1:8080", 200),
        ("localhost:8080", 200),
        ("[::1]:8080", 200),
        ("192.168.1.20", 200),
        ("plant.example", 200),
        ("evil.example", 403),
        ("127.0.0.1.evil.example", 403),
        ("localhost.evil.example:8080", 403),
        ("", 403),
        ("[", 403),
        ("plant.example.evil.example", 403),
    ],
)
def test_a_foreign_name_that_resolves_to_this_machine_is_denied(host: str, status: int, tmp_path: Path) -> None:
    """DNS rebinding: for the browser that page and this service are one origin; only Host shows the difference."""
    harness = WebAppHarness(tmp_path, web=WebConfig(origins=("https://plant.example",)))

    async def scenario() -> None:
        client = harness.client()
        assert (await client.get("/api/v1/session", headers={"host": host})).status_code == status
        page = await client.get("/", headers={"host": host})
        assert page.status_code == status
        assert status == 200 or page.json()["error"]["code"] == "auth.foreign_host"

    run(scenario())


def test_the_denial_of_a_page_behind_a_reverse_proxy_names_the_key_that_it_needs(tmp_path: Path) -> None:
    """The proxy ends the TLS: the browser's origin is https, and the service is reached by http."""
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client = harness.client(host="192.168.1.20", origin="https://192.168.1.20")
        answer = await client.post("/api/v1/login", json={"name": "operator", "password": "correct horse battery"})
        error = answer.json()["error"]
        assert (answer.status_code, error["code"]) == (403, "auth.foreign_origin")
        assert all("origins" in text and "plant.toml" in text for text in error["text"].values()), error["text"]

    run(scenario())


def test_the_origin_of_a_reverse_proxy_is_accepted_where_it_is_configured(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path, web=WebConfig(origins=("https://plant.example",)))

    async def scenario() -> None:
        client = harness.client(host="plant.example", origin="https://plant.example")
        body = {"name": "operator", "password": "correct horse battery"}
        answer = await client.post("/api/v1/login", json=body)
        cookie = answer.headers["set-cookie"]
        assert cookie.startswith("__Host-drivebus=") and "Secure" in cookie
        csrf = {"x-drivebus-csrf": answer.json()["csrf"], "cookie": cookie.partition(";")[0]}
        assert (await client.post("/api/v1/stop", headers=csrf)).status_code == 200

    run(scenario())


@pytest.mark.parametrize(
    ("host", "origin"),
    [("plant.example", None), ("plant.example", "https://plant.example"), ("127.0.0.1:8080", "https://plant.example")],
    ids=["request without Origin", "proxy that leaves the Host", "proxy that replaces the Host"],
)
def test_the_cookie_that_a_login_behind_a_proxy_sets_is_the_one_that_is_read(
    host: str, origin: str | None, tmp_path: Path
) -> None:
    """A cookie without the prefix, set over TLS, would be no session in the next request."""
    harness = WebAppHarness(tmp_path, web=WebConfig(origins=("https://plant.example",)))

    async def scenario() -> None:
        client = harness.client(host=host)
        headers = {} if origin is None else {"origin": origin}
        body = {"name": "operator", "password": "correct horse battery"}
        answer = await client.post("/api/v1/login", json=body, headers=headers)
        cookies = answer.headers.get_list("set-cookie")
        assert len(cookies) == 2
        assert all(cookie.startswith("__Host-drivebus") and "; Secure" in cookie for cookie in cookies)
        headers |= {"x-drivebus-csrf": answer.json()["csrf"], "cookie": cookies[0].partition(";")[0]}
        assert (await client.post("/api/v1/stop", headers=headers)).status_code == 200

    run(scenario())


async def cookie_of(harness: WebAppHarness, role: str = "operator") -> tuple[Any, dict[str, str]]:
    client = await harness.log_in(role)
    headers = {"host": "127.0.0.1:8080", "cookie": "drivebus_session=" + client.cookies["drivebus_session"]}
    return client, headers


def test_a_handshake_from_our_own_page_is_accepted(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        _, headers = await cookie_of(harness)
        wire = AppWebSocket(harness.app, headers | {"origin": BASE})
        await asyncio.sleep(1)
        assert wire.is_open
        await wire.disconnect()

    run(scenario())


@pytest.mark.parametrize("origin", [None, *FOREIGN])
def test_a_handshake_from_another_origin_is_refused(origin: str | None, tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        _, headers = await cookie_of(harness)
        wire = AppWebSocket(harness.app, headers if origin is None else headers | {"origin": origin})
        await wire.route
        assert (wire.is_open, wire.close_code, harness.service.calls) == (False, 4403, [])
        target = "/api/v1/live" if origin is None else "-"  # a foreign origin is refused before routing
        assert harness.service.records[-1][0]["target"] == f"WEBSOCKET {target}"

    run(scenario())


@pytest.mark.parametrize(
    "credential", [{}, {"cookie": "drivebus_session=" + "A" * 43}, {"authorization": "Bearer dbt_A"}]
)
def test_a_handshake_without_a_session_is_refused(credential: dict[str, str], tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        wire = AppWebSocket(harness.app, {"host": "127.0.0.1:8080", "origin": BASE} | credential)
        await wire.route
        assert (wire.is_open, wire.close_code, harness.service.calls) == (False, 4401, [])

    run(scenario())


def test_a_program_with_a_token_needs_no_origin(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        token = await harness.token("operator", "view")
        wire = AppWebSocket(harness.app, {"host": "127.0.0.1:8080", "authorization": f"Bearer {token}"})
        await asyncio.sleep(1)
        assert wire.is_open
        operator = await harness.log_in("operator")
        mine = (await operator.get("/api/v1/tokens")).json()["tokens"][0]["id"]
        await operator.delete(f"/api/v1/tokens/{mine}")
        await asyncio.sleep(1)
        assert wire.close_code == 4401

    run(scenario())


async def log_out(harness: WebAppHarness, client: Any) -> None:
    assert (await client.post("/api/v1/logout")).status_code == 200


async def log_out_everywhere(harness: WebAppHarness, client: Any) -> None:
    other = await harness.log_in("operator")
    assert (await other.post("/api/v1/logout?all=true")).json() == {"ended": 2}


async def lose_the_role(harness: WebAppHarness, client: Any) -> None:
    admin = await harness.log_in("administrator")
    assert (await admin.patch("/api/v1/users/operator", json={"role": "viewer"})).status_code == 200


async def be_disabled(harness: WebAppHarness, client: Any) -> None:
    admin = await harness.log_in("administrator")
    assert (await admin.patch("/api/v1/users/operator", json={"disabled": True})).status_code == 200


async def be_removed(harness: WebAppHarness, client: Any) -> None:
    admin = await harness.log_in("administrator")
    assert (await admin.delete("/api/v1/users/operator")).status_code == 200


async def be_changed_on_the_command_line(harness: WebAppHarness, client: Any) -> None:
    harness.auth.user_file.change(lambda register: register.without_user("operator"))


async def have_ones_sessions_ended(harness: WebAppHarness, client: Any) -> None:
    admin = await harness.log_in("administrator")
    assert (await admin.patch("/api/v1/users/operator", json={"end_sessions": True})).status_code == 200


async def log_in_again(harness: WebAppHarness, client: Any) -> None:
    body = {"name": "operator", "password": "correct horse battery"}
    assert (await client.post("/api/v1/login", json=body)).status_code == 200


@pytest.mark.parametrize(
    "end",
    [
        log_out,
        log_out_everywhere,
        lose_the_role,
        be_disabled,
        be_removed,
        be_changed_on_the_command_line,
        have_ones_sessions_ended,
        log_in_again,
    ],
)
def test_an_open_connection_ends_within_a_second_of_its_session(end: Any, tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client, headers = await cookie_of(harness)
        wire = AppWebSocket(harness.app, headers | {"origin": BASE})
        await asyncio.sleep(5)
        assert wire.is_open
        await end(harness, client)
        sent_before = len(wire.sent)
        await asyncio.sleep(1)
        assert wire.close_code == 4401 and wire.route.done()
        last = json.loads(wire.sent[-2]["text"])
        assert last["type"] == "closed" and last["text"].keys() == {"en", "zh"}
        assert len(wire.sent) - sent_before <= 2, "no data of the plant is sent any more"

    run(scenario())


def test_a_connection_ends_when_its_session_expires_after_twelve_hours(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        _, headers = await cookie_of(harness)
        wire = AppWebSocket(harness.app, headers | {"origin": BASE})
        await asyncio.sleep(5)
        harness.clock.now += 12 * 3600.0
        await asyncio.sleep(1)
        assert wire.close_code == 4401

    run(scenario())
