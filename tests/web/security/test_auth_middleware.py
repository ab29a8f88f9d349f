"""Authentication middleware: reading of headers and denial of requests."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from starlette.datastructures import Headers

from drivebus.testing.virtual_time import run
from drivebus.web.gateway import WebConfig
from drivebus.web.middleware.auth import AuthMiddleware, client_address, session_cookie
from drivebus.web.middleware.host_check import HostCheck
from drivebus.web.middleware.trusted_proxies import TrustedProxies
from drivebus.web.route import RouteTable
from drivebus.web.session_end import SessionEndWatch
from fixtures.web_app import PASSWORD, AppWebSocket, WebAppHarness


@pytest.mark.parametrize(
    ("lines", "secret"),
    [
        ([], None),
        (["other=1"], None),
        (["drivebus_session=a"], "a"),
        (["__Host-drivebus=b"], "b"),
        (["drivebus_session=a; __Host-drivebus=b"], "b"),
        (["x[=1;", "drivebus_session=a"], "a"),
        (['x={"a": 1}; drivebus_session=a'], "a"),
        (["a,b=1; drivebus_session=a; c"], "a"),
        (["drivebus_session="], ""),
        (["other=drivebus_session=b"], None),
        (["drivebus_session=old; x=1;drivebus_session=a "], "a"),
        (["bad\x01name=1; ", "drivebus_session=a"], "a"),
    ],
)
def test_the_cookie_with_the_host_prefix_takes_precedence(lines: list[str], secret: str | None) -> None:
    """A page on another port can set a cookie without the prefix; an unreadable cookie hides no valid one."""
    headers = Headers(raw=[(b"cookie", line.encode()) for line in lines])
    assert session_cookie(headers) == secret
    assert session_cookie(headers, uses_tls=True) == (secret if secret == "b" else None)


def test_over_tls_no_cookie_without_the_prefix_is_a_session(tmp_path: Path) -> None:
    """A page over HTTP, or of another port, could log a user in as another one."""
    harness = WebAppHarness(tmp_path, web=WebConfig(origins=("https://plant.example",)))

    async def scenario() -> None:
        cookie = (await harness.log_in("operator")).cookies["drivebus_session"]
        for name, user in (("drivebus_session", None), ("__Host-drivebus", "operator")):
            page = harness.client(host="plant.example", cookie=f"{name}={cookie}")
            assert (await page.get("/api/v1/session")).json()["user"] == user
        page = harness.client(host="127.0.0.1", cookie=f"drivebus_session={cookie}")
        assert (await page.get("/api/v1/session")).json()["user"] == "operator"

    run(scenario())


@pytest.mark.parametrize(("client", "expected"), [(("10.0.0.9", 1), "10.0.0.9"), (None, "local")])
def test_the_address_of_a_client_is_that_of_its_connection(client: tuple[str, int] | None, expected: str) -> None:
    assert client_address({"client": client, "headers": [(b"x-forwarded-for", b"::1")]}) == expected
    assert client_address({}) == "local"


@pytest.mark.parametrize(
    ("method", "path", "status", "key"),
    [
        ("GET", "/api/v1/nothing", 404, "auth.no_such_address"),
        ("PUT", "/api/v1/stop", 405, "auth.no_such_method"),
        ("FETCH", "/api/v1/users", 405, "auth.no_such_method"),
        ("POST", "/api/v1/stop", 401, "auth.not_logged_in"),
        ("GET", "/api/v1/drives", 401, "auth.not_logged_in"),
        ("POST", "/api/v1/logout", 401, "auth.not_logged_in"),
    ],
)
def test_a_denied_request_gets_a_reason_and_is_recorded(
    method: str, path: str, status: int, key: str, tmp_path: Path
) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        answer = await harness.client().request(method, path)
        assert (answer.status_code, answer.json()["error"]["code"]) == (status, key)
        assert answer.headers["connection"] == "close"
        assert answer.headers.get("allow") == {"PUT": "POST", "FETCH": "GET, HEAD, POST"}.get(method)
        (message,) = harness.service.records
        assert message[0] == {
            "what": "refused",
            "target": f"{method} {'-' if status == 404 else path}",
            "outcome": key,
            "params": {"who": "@127.0.0.1", "times": 1},
        }
        assert (message[1].name, message[1].rights, message[1].remote) == ("", frozenset(), True)

    run(scenario())


def test_a_token_reaches_routes_with_a_right_and_not_those_of_browser_sessions(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        secret = await harness.token("operator", "view", "stop")
        for scheme in ("Bearer", "bearer", "BEARER"):
            client = harness.client(authorization=f"{scheme}  {secret} ")
            assert (await client.get("/api/v1/drives")).status_code == 200
        answer = await client.get("/api/v1/tokens")
        assert (answer.status_code, answer.json()["error"]["code"]) == (403, "auth.only_session")
        answer = await client.post("/api/v1/drives/fan-1/reset")
        assert (answer.status_code, answer.json()["error"]["code"]) == (403, "auth.token_forbidden")
        assert answer.json()["error"]["params"] == {"right": "operate", "token": "t"}
        assert answer.json()["error"]["text"]["en"].startswith("The token t does not have the right operate, which its")
        answer = await client.put("/api/v1/drives/fan-1/limits", json={})
        assert (answer.status_code, answer.json()["error"]["code"]) == (403, "auth.forbidden"), "nor has its user"
        wrong = harness.client(authorization=f"Basic {secret}")
        assert (await wrong.get("/api/v1/drives")).status_code == 401

    run(scenario())


def test_a_read_is_answered_from_any_link_and_is_readable_by_no_other_page(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client = await harness.log_in("viewer")
        answer = await client.get("/api/v1/session", headers={"origin": "http://evil.example"})
        assert answer.status_code == 200 and "access-control-allow-origin" not in answer.headers
        refused = await client.post("/api/v1/session/activity", headers={"origin": "http://evil.example"})
        assert (refused.status_code, refused.json()["error"]["code"]) == (403, "auth.foreign_origin")

    run(scenario())


@pytest.mark.parametrize("name", ["token", "access_token", "authorization", "session", "drivebus_session"])
def test_no_secret_in_an_address_is_a_credential(name: str, tmp_path: Path) -> None:
    """Addresses are in logs and in the history of browsers."""
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        secret = await harness.token("operator", "view")
        cookie = (await harness.log_in("operator")).cookies["drivebus_session"]
        by_header = await harness.client(authorization=f"Bearer {secret}").get("/api/v1/drives")
        assert by_header.status_code != 401
        for value in (secret, f"Bearer {secret}", cookie):
            answer = await harness.client().get("/api/v1/drives", params={name: value})
            assert answer.status_code == 401

    run(scenario())


def test_a_login_with_an_old_cookie_needs_no_csrf_token(tmp_path: Path) -> None:
    """A closed page has lost its CSRF token, but the browser still has the cookie."""
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client = await harness.log_in("operator")
        del client.headers["X-Drivebus-CSRF"]
        answer = await client.post("/api/v1/login", json={"name": "operator", "password": PASSWORD})
        assert answer.status_code == 200
        answer = await client.post("/api/v1/stop")
        assert (answer.status_code, answer.json()["error"]["code"]) == (403, "auth.csrf")

    run(scenario())


def test_the_middleware_forwards_lifespan_and_denies_a_handshake_without_an_origin(tmp_path: Path) -> None:
    harness, received = WebAppHarness(tmp_path), list[str]()

    async def app(scope: Any, receive: Any, send: Any) -> None:
        received.append(scope["type"])

    async def nothing(*_: Any) -> Any:
        raise AssertionError

    async def scenario() -> None:
        guard = AuthMiddleware(
            app,
            auth=harness.auth,
            hosts=HostCheck(WebConfig()),
            proxies=TrustedProxies(()),
            aggregator=harness.aggregator,
            routes=RouteTable([]),
            end_watch=SessionEndWatch(harness.service),
        )
        await guard({"type": "lifespan"}, nothing, nothing)
        assert received == ["lifespan"]
        client = await harness.log_in("operator")
        wire = AppWebSocket(
            harness.app, {"host": "127.0.0.1", "cookie": f"drivebus_session={client.cookies['drivebus_session']}"}
        )
        await wire.route
        assert wire.close_code == 4403 and harness.service.records[-1][0]["outcome"] == "auth.foreign_origin"

    run(scenario())


def test_before_the_set_up_every_command_is_a_conflict_and_the_set_up_is_open(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path, users=False)

    async def scenario() -> None:
        for method, path, status in (
            ("POST", "/stop", 409),
            ("GET", "/drives", 409),
            ("POST", "/logout", 409),
            ("GET", "/session", 200),
        ):
            answer = await harness.client().request(method, f"/api/v1{path}")
            assert answer.status_code == status
            assert status == 200 or answer.json()["error"]["code"] == "auth.setup_needed"

    run(scenario())


def test_an_idle_session_is_denied_with_that_reason(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client = await harness.log_in("operator")
        harness.clock.now += 900.0
        for path, status, code in (("reset", 403, "auth.idle"), ("stop", 200, None)):
            answer = await client.post(f"/api/v1/drives/fan-1/{path}")
            assert (answer.status_code, answer.json().get("error", {}).get("code")) == (status, code)

    run(scenario())


def test_only_a_persons_actions_keep_a_session_active(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client = await harness.log_in("operator")
        (session,) = harness.auth.sessions.of_user("operator")
        for method, path, awake in (
            ("GET", "/drives", False),
            ("POST", "/drives/fan-1/lease/renew", False),
            ("POST", "/stop", True),
        ):
            harness.clock.now += 1.0
            before = session.active
            assert (await client.request(method, f"/api/v1{path}")).status_code == 200
            assert session.active == (harness.clock.now if awake else before)

    run(scenario())


def test_an_invalid_token_does_not_fall_back_to_the_cookie(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client = await harness.log_in("operator")
        answer = await client.post("/api/v1/stop", headers={"authorization": "Bearer dbt_x"})
        assert answer.status_code == 401 and harness.service.calls == []

    run(scenario())
