"""Every route requires its declared access, and nothing else is reached."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from fastapi.routing import iter_route_contexts
from httpx import AsyncClient

from drivebus.service.api.operations import OPERATIONS
from drivebus.service.auth.rights import ROLE_RIGHTS, AccessLevel, Right, Role
from drivebus.testing.virtual_time import run
from drivebus.web.app import declared_routes
from drivebus.web.gateway import WebConfig
from drivebus.web.operations import WEB_OPERATIONS
from drivebus.web.route import WEBSOCKET, AccessRouter, Route, RouteTable
from fixtures.web_app import PASSWORD, WebAppHarness

ROUTES = declared_routes()
HTTP_ROUTES = [route for route in ROUTES if route.method != WEBSOCKET]
EVERY_OPERATION = [*OPERATIONS.values(), *WEB_OPERATIONS.values()]
CLOSED_ROUTES = [route for route in HTTP_ROUTES if route.access is not AccessLevel.PUBLIC]


def address(route: Route) -> str:
    return re.sub(r"{\w+(:path)?}", "x1", route.path)


def test_the_routes_of_the_framework_are_those_that_are_declared(tmp_path: Path) -> None:
    found = set()
    for route in iter_route_contexts(WebAppHarness(tmp_path).app.routes):
        for method in route.methods or {WEBSOCKET}:
            found.add((method, route.path))
    assert found == {(route.method, route.path) for route in ROUTES}


def test_a_route_that_is_declared_twice_is_rejected() -> None:
    with pytest.raises(ValueError, match="twice"):
        RouteTable([ROUTES[0], ROUTES[0]])


def test_a_route_of_an_operation_requires_the_right_of_the_operation() -> None:
    access = {(route.method, route.path): route.access for route in ROUTES}
    for operation in EVERY_OPERATION:
        assert access[operation.method, operation.url_path] is operation.right


def test_only_files_of_the_page_and_the_websocket_are_no_operations() -> None:
    """The reasons are in docs/explanation/architecture.md."""
    declared = {(operation.method, operation.url_path) for operation in EVERY_OPERATION}
    assert {(route.method, route.path) for route in ROUTES} - declared == {
        ("GET", "/"),
        ("GET", "/static/{path:path}"),
        ("GET", "/vendor/{path:path}"),
        ("GET", "/i18n/{language}.json"),
        (WEBSOCKET, "/api/v1/live"),
    }


def test_no_operation_that_changes_anything_is_reached_by_get() -> None:
    assert not [operation for operation in EVERY_OPERATION if operation.mutates and operation.method == "GET"]


def test_commands_and_renewals_do_not_wait_in_the_read_queue() -> None:
    """A stop that overtakes a command sent before it would not void that command."""
    yields = {(route.method, route.path): route.yields for route in ROUTES}
    urgent = [
        operation for operation in EVERY_OPERATION if not operation.yields and operation.right is not AccessLevel.PUBLIC
    ]
    assert urgent and not [operation for operation in urgent if yields[operation.method, operation.url_path]]
    assert all(
        route.yields for route in ROUTES if route.method in ("GET", WEBSOCKET) or route.access is AccessLevel.PUBLIC
    )


def test_only_routes_that_a_login_needs_are_public() -> None:
    assert {(route.method, route.path) for route in ROUTES if route.access is AccessLevel.PUBLIC} == {
        ("GET", "/"),
        ("GET", "/static/{path:path}"),
        ("GET", "/vendor/{path:path}"),
        ("GET", "/i18n/{language}.json"),
        ("GET", "/api/v1/health"),
        ("GET", "/api/v1/session"),
        ("POST", "/api/v1/login"),
        ("POST", "/api/v1/login/code"),
        ("POST", "/api/v1/setup"),
    }


async def test_head_is_answered_as_get_without_the_body_and_needs_its_right(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)
    viewer, anybody = await harness.log_in("viewer"), harness.client()
    for client, path, status in (
        (anybody, "/api/v1/health", 200),
        (anybody, "/", 200),
        (anybody, "/static/js/app.js", 200),
        (anybody, "/api/v1/drives", 401),
        (anybody, "/api/v1/nowhere", 404),
        (viewer, "/api/v1/drives", 200),
        (viewer, "/api/v1/users", 403),
        (viewer, "/api/v1/buses/A%20B", 422),
    ):
        head, get = await client.head(path), await client.get(path)
        assert (head.status_code, get.status_code, head.content) == (status, status, b""), path
        assert head.headers["content-length"] == get.headers["content-length"]
    harness.service.calls.clear()
    operator = await harness.log_in("operator")
    assert (await operator.head("/api/v1/stop")).status_code == 405
    assert harness.service.calls == []


@pytest.mark.parametrize(
    ("method", "path", "status", "allowed"),
    [
        ("GET", "/api/v1/stop", 405, "POST"),
        ("DELETE", "/api/v1/users", 405, "GET, HEAD, POST"),
        ("OPTIONS", "/api/v1/drives/fan-1", 405, "GET, HEAD"),
        ("GET", "/api/v1/nowhere", 404, None),
        ("POST", "/api/v2/stop", 404, None),
    ],
)
async def test_an_unknown_path_is_404_and_a_known_one_names_its_methods(
    method: str, path: str, status: int, allowed: str | None, tmp_path: Path
) -> None:
    answer = await (await WebAppHarness(tmp_path).log_in("operator")).request(method, path)
    assert (answer.status_code, answer.headers.get("allow")) == (status, allowed)
    assert answer.json()["error"]["text"].keys() == {"en", "zh"}


def test_a_route_without_declared_access_never_reaches_the_framework(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path, web=WebConfig(port=8081))

    @harness.app.post("/api/v1/undeclared")
    async def undeclared() -> dict[str, str]:
        harness.service.calls.append(("undeclared", {}, None))  # type: ignore[arg-type]
        return {}

    async def scenario() -> None:
        client = await harness.log_in("administrator")
        assert (await client.post("/api/v1/undeclared")).status_code == 404
        assert harness.service.calls == []

    run(scenario())


def test_the_router_rejects_a_route_without_declared_access() -> None:
    with pytest.raises(TypeError, match="access"):
        AccessRouter().exempt("GET", "/open")  # type: ignore[call-arg]


TABLE = RouteTable(ROUTES)


@pytest.mark.parametrize(
    ("path", "declared"),
    [
        ("/static/js/app.js", "/static/{path:path}"),
        ("/vendor/a", "/vendor/{path:path}"),
        ("/", "/"),
        ("/i18n/en.json", "/i18n/{language}.json"),
        ("/api/v1/live", "/api/v1/live"),
        ("/api/v1/drives/fan-1/lease", "/api/v1/drives/{drive}/lease"),
    ],
)
def test_a_path_is_found_by_its_declaration(path: str, declared: str) -> None:
    assert {route.path for route in TABLE.match(path)} == {declared}
    assert [route.method for route in TABLE.match("/api/v1/live")] == ["WEBSOCKET"]


@pytest.mark.parametrize(
    "path",
    [
        "/static/",
        "/i18n/a/b.json",
        "/api/v1/drives//run",
        "/api/v1/drives/a/b/run",
        "/api/v1//stop",
        "/api/v1/stop/",
        "/I18N/en.json",
        "/i18n/enXjson",
    ],
)
def test_a_path_that_only_resembles_a_route_is_unknown(path: str) -> None:
    assert TABLE.match(path) == []


BAD = {
    "nothing": {},
    "a forged cookie": {"cookie": "drivebus_session=" + "A" * 43, "x-drivebus-csrf": "A" * 32},
    "a forged token": {"authorization": "Bearer dbt_" + "A" * 43},
    "another scheme": {"authorization": "Basic YWRtaW46YWRtaW4="},
    "an empty token": {"authorization": "Bearer "},
}


@pytest.mark.parametrize("kind", BAD)
def test_without_a_valid_credential_every_route_is_401_and_calls_no_operation(kind: str, tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client = harness.client(**BAD[kind])
        for route in CLOSED_ROUTES:
            answer = await client.request(route.method, address(route))
            assert answer.status_code == 401, (route, answer.text)
            assert answer.json()["error"]["kind"] == "NotAuthenticated"
        assert harness.service.calls == []
        message = [entry["target"] for entry, _ in harness.service.records if entry["what"] == "refused"]
        assert counted(harness) == len(CLOSED_ROUTES)
        assert message[0] == f"{CLOSED_ROUTES[0].method} {CLOSED_ROUTES[0].path}"

    run(scenario())


def counted(harness: WebAppHarness) -> int:
    """Return the number of denials: recorded ones with their repetitions, and those still being counted."""
    aggregator = harness.aggregator
    message = sum(entry["params"]["times"] for entry, _ in harness.service.records if entry["what"] == "refused")
    return message + sum(aggregator._counts.values())


async def expired_session(harness: WebAppHarness) -> AsyncClient:
    client = await harness.log_in("administrator")
    harness.clock.now += 12 * 3600.0
    return client


async def ended_session(harness: WebAppHarness) -> AsyncClient:
    client = await harness.log_in("administrator")
    cookie = client.cookies["drivebus_session"]
    assert (await client.post("/api/v1/logout")).status_code == 200
    client.cookies.set("drivebus_session", cookie, domain="127.0.0.1")
    return client


async def session_of_one_removed(harness: WebAppHarness) -> AsyncClient:
    client = await harness.log_in("engineer")
    harness.auth.user_file.change(lambda register: register.without_user("engineer"))
    return client


async def expired_token(harness: WebAppHarness) -> AsyncClient:
    secret = await harness.token("administrator", *map(str, Right))
    harness.clock.now += 86_400.0
    return harness.client(authorization=f"Bearer {secret}")


async def withdrawn_token(harness: WebAppHarness) -> AsyncClient:
    client = await harness.log_in("administrator")
    made = (await client.post("/api/v1/tokens", json={"name": "t", "rights": ["view", "stop"], "days": 1})).json()
    assert (await client.delete(f"/api/v1/tokens/{made['token']['id']}")).status_code == 200
    return harness.client(authorization=f"Bearer {made['secret']}")


@pytest.mark.parametrize(
    "spent", [expired_session, ended_session, session_of_one_removed, expired_token, withdrawn_token]
)
def test_an_ended_credential_is_401_everywhere(spent, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client = await spent(harness)
        harness.service.calls.clear()
        for route in CLOSED_ROUTES:
            answer = await client.request(route.method, address(route))
            assert answer.status_code == 401, (route, answer.text)
        assert harness.service.calls == []

    run(scenario())


@pytest.mark.parametrize("role", list(Role))
def test_a_role_reaches_what_its_rights_allow_and_nothing_more(role: Role, tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client = await harness.log_in(role)
        for route in CLOSED_ROUTES:
            if not isinstance(route.access, Right):
                continue
            harness.service.calls.clear()
            answer = await client.request(route.method, address(route))
            if route.access in ROLE_RIGHTS[role]:
                assert answer.status_code not in (401, 403), (route, answer.text)
            else:
                assert (answer.status_code, harness.service.calls) == (403, []), route
        assert role is Role.ADMINISTRATOR or counted(harness) > 0

    run(scenario())


@pytest.mark.parametrize("right", list(Right))
def test_a_token_reaches_only_its_scope_though_its_user_has_more_rights(right: Right, tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)
    rights = (right, Right.STOP) if right is Right.OPERATE else (right,)

    async def scenario() -> None:
        client = harness.client(authorization=f"Bearer {await harness.token('administrator', *rights)}")
        for route in CLOSED_ROUTES:
            harness.service.calls.clear()
            answer = await client.request(route.method, address(route))
            if route.access in rights:
                assert answer.status_code not in (401, 403), (route, answer.text)
            else:
                assert (answer.status_code, harness.service.calls) == (403, []), route

    run(scenario())


def test_a_token_loses_the_rights_that_its_user_loses(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client = harness.client(
            authorization=f"Bearer {await harness.token('engineer', 'view', 'stop', 'write_parameters')}"
        )
        admin = await harness.log_in("administrator")
        path = "/api/v1/drives/fan-1/parameters/write"
        assert (await client.post(path, json={"values": {"F0.1": 1.0}})).status_code == 200
        assert (await admin.patch("/api/v1/users/engineer", json={"role": "operator"})).status_code == 200
        assert (await client.post(path, json={"values": {"F0.1": 1.0}})).status_code == 403
        assert (await client.post("/api/v1/stop")).status_code == 200
        assert (await admin.patch("/api/v1/users/engineer", json={"disabled": True})).status_code == 200
        assert (await client.post("/api/v1/stop")).status_code in (401, 403)

    run(scenario())


def test_one_users_session_has_no_right_of_another_user(tmp_path: Path) -> None:
    """The actor is that of the credential, not the one that the request names."""
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        operator, engineer = await harness.log_in("operator"), await harness.log_in("engineer")
        operator.headers["X-Drivebus-CSRF"] = engineer.headers["X-Drivebus-CSRF"]
        assert (await operator.post("/api/v1/stop")).status_code == 403, "another's CSRF token"
        mine = (await engineer.post("/api/v1/tokens", json={"name": "t", "rights": ["view"]})).json()["token"]["id"]
        operator = await harness.log_in("operator")
        assert (await operator.get("/api/v1/tokens")).json() == {"tokens": []}
        assert (await operator.delete(f"/api/v1/tokens/{mine}")).status_code == 404
        claims = {"user": "engineer", "role": "administrator", "x-user": "administrator", "x-forwarded-for": "::1"}
        await operator.post("/api/v1/stop", headers=claims)
        assert [(call[2].name, call[2].address) for call in harness.service.calls] == [("operator", "127.0.0.1")]

    run(scenario())


def test_a_token_has_no_right_that_its_user_lacks(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        operator = await harness.log_in("operator")
        answer = await operator.post("/api/v1/tokens", json={"name": "t", "rights": ["view", "write_parameters"]})
        assert answer.status_code == 403
        harness.clock.now += 900.0
        answer = await operator.post("/api/v1/tokens", json={"name": "t", "rights": ["operate"]})
        assert answer.status_code == 403, "an idle session adds no token"
        admin = await harness.log_in("administrator")
        for change in ({"role": "viewer"}, {"disabled": True}):
            assert (await admin.patch("/api/v1/users/administrator", json=change)).status_code == 409
        assert (await admin.delete("/api/v1/users/administrator")).status_code == 409

    run(scenario())


@pytest.mark.parametrize(
    ("method", "path", "body"),
    [
        ("POST", "/users", {"name": "eve", "role": "administrator", "password": "long enough 1", "rights": ["x"]}),
        ("POST", "/users", {"name": "eve", "role": "god", "password": PASSWORD}),
        ("POST", "/users", {"name": ["eve"], "role": "viewer", "password": PASSWORD}),
        ("PATCH", "/users/viewer", {"disabled": "yes"}),
        ("PATCH", "/users/viewer", {"disabled": 1}),
        ("PATCH", "/users/viewer", {"name": "eve"}),
        ("POST", "/tokens", {"name": "t", "rights": [], "days": 1}),
        ("POST", "/tokens", {"name": "t", "rights": ["view"], "days": "1"}),
        ("POST", "/tokens", {"name": "t", "rights": ["view"], "days": 1e9}),
        ("POST", "/tokens", {"name": "t", "rights": ["view"], "days": -1}),
        ("POST", "/tokens", {"name": "t", "rights": ["view"], "token": "x"}),
        ("PATCH", "/users/viewer", {"user": "operator", "role": "viewer"}),
        ("POST", "/login?name=viewer", {"name": "viewer", "password": PASSWORD}),
        ("POST", "/logout?all=1", {}),
        ("POST", "/logout?everything=true", {}),
        ("POST", "/login", {"name": "viewer", "password": {"$ne": ""}}),
        ("POST", "/login", None),
    ],
)
def test_a_body_of_another_shape_is_rejected_and_changes_nothing(
    method: str, path: str, body: object, tmp_path: Path
) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        admin = await harness.log_in("administrator")
        before = harness.auth.database
        answer = await admin.request(method, f"/api/v1{path}", json=body)
        assert answer.status_code == 422, answer.text
        error = answer.json()["error"]
        assert error["text"].keys() == {"en", "zh"} and error["kind"] == "InvalidParameters"
        assert harness.auth.database == before

    run(scenario())


@pytest.mark.parametrize(
    ("body", "path", "chinese"),
    [
        ('{"name": "t", "rights": ["view"], "days": 0}', "days", "应不小于 1"),
        ('{"name": "t", "rights": ["fly"]}', "rights.0", "应为以下之一：'view'"),
        ("[1]", "", "应为对象"),
    ],
)
def test_a_rejected_body_is_explained_in_both_languages(body: str, path: str, chinese: str, tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        admin = await harness.log_in("administrator")
        kind = {"content-type": "application/json"}
        error = (await admin.post("/api/v1/tokens", content=body, headers=kind)).json()["error"]
        message = error["params"]["faults"][0]
        assert (message["path"], message["expected"]["zh"][: len(chinese)]) == (path, chinese)
        assert chinese in error["text"]["zh"] and message["expected"]["en"] in error["text"]["en"]

    run(scenario())
