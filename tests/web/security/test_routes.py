"""S01, S02: every address has a line in the rights table, and what the table says is what happens."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from fastapi.routing import iter_route_contexts
from httpx import AsyncClient

from drivebus.service.api.operations import OPERATIONS
from drivebus.service.auth.rights import ROLE_RIGHTS, Right, Role
from drivebus.service.config.model import WebConfig
from drivebus.testing.virtual_time import run
from drivebus.web.api.table import API_PREFIX, API_ROUTES
from drivebus.web.route_policy import ROUTE_POLICIES, WEBSOCKET, AccessLevel, RoutePolicy, policies_for
from fixtures.web_app import PASSWORD, WebAppHarness

HTTP = [entry for entry in ROUTE_POLICIES if entry.method != WEBSOCKET]
CLOSED = [entry for entry in HTTP if entry.access is not AccessLevel.PUBLIC]


def address(entry: RoutePolicy) -> str:
    return re.sub(r"{\w+(:path)?}", "x1", entry.path)


def test_s02_the_frameworks_inventory_is_the_rights_table(tmp_path: Path) -> None:
    found = set()
    for route in iter_route_contexts(WebAppHarness(tmp_path).app.routes):
        for method in route.methods or {WEBSOCKET}:
            found.add((method, route.path))
    assert found - {("HEAD", "/api/v1/openapi.json")} == {(entry.method, entry.path) for entry in ROUTE_POLICIES}
    assert len(ROUTE_POLICIES) == len({(entry.method, entry.path) for entry in ROUTE_POLICIES})


def test_s02_the_table_asks_for_the_right_that_the_operation_asks_for() -> None:
    needs = {(entry.method, entry.path): entry.access for entry in ROUTE_POLICIES}
    assert {needs[route.method, API_PREFIX + route.path] == route.operation.right for route in API_ROUTES} == {True}
    assert {route.name for route in API_ROUTES} == OPERATIONS.keys()


def test_s03_what_changes_something_is_never_reached_by_get() -> None:
    assert not [route for route in API_ROUTES if route.operation.mutates and route.method == "GET"]


def test_s14_no_command_and_no_renewal_waits_at_the_door() -> None:
    """6.5: a stop that came in front of a command asked before it would not void it."""
    waits = {(entry.method, entry.path): entry.yields for entry in ROUTE_POLICIES}
    kept = [route for route in API_ROUTES if not route.operation.yields]
    assert kept and not [route for route in kept if waits[route.method, API_PREFIX + route.path]]
    assert all(
        entry.yields
        for entry in ROUTE_POLICIES
        if entry.method in ("GET", WEBSOCKET) or entry.access is AccessLevel.PUBLIC
    )


def test_s02_public_is_only_what_a_stranger_needs_to_log_in() -> None:
    assert {(entry.method, entry.path) for entry in ROUTE_POLICIES if entry.access is AccessLevel.PUBLIC} == {
        ("GET", "/"),
        ("GET", "/static/{path:path}"),
        ("GET", "/vendor/{path:path}"),
        ("GET", "/i18n/{language}.json"),
        ("GET", "/api/v1/health"),
        ("GET", "/api/v1/session"),
        ("POST", "/api/v1/login"),
        ("POST", "/api/v1/login-once"),
        ("POST", "/api/v1/setup"),
    }


def test_s02_an_address_that_is_not_in_the_table_never_reaches_the_framework(tmp_path: Path) -> None:
    """Its line is forgotten, and so is the address."""
    house = WebAppHarness(tmp_path, web=WebConfig(port=8081))

    @house.app.post("/api/v1/forgotten")
    async def forgotten() -> dict[str, str]:
        house.plant.calls.append(("forgotten", {}, None))  # type: ignore[arg-type]
        return {}

    async def story() -> None:
        client = await house.log_in("administrator")
        assert (await client.post("/api/v1/forgotten")).status_code == 404
        assert house.plant.calls == []

    run(story())


@pytest.mark.parametrize(
    ("path", "line"),
    [
        ("/static/js/app.js", "/static/{path:path}"),
        ("/vendor/a", "/vendor/{path:path}"),
        ("/", "/"),
        ("/i18n/en.json", "/i18n/{language}.json"),
        ("/api/v1/live", "/api/v1/live"),
        ("/api/v1/drives/fan-1/lease", "/api/v1/drives/{drive}/lease"),
    ],
)
def test_s02_an_address_is_found_by_its_line(path: str, line: str) -> None:
    assert {entry.path for entry in policies_for(path)} == {line}
    assert [entry.method for entry in policies_for("/api/v1/live")] == ["WEBSOCKET"]


@pytest.mark.parametrize("path", ["/static/", "/i18n/a/b.json", "/api/v1/drives//run"])
def test_s02_an_address_with_a_piece_of_nothing_or_of_two_is_none(path: str) -> None:
    assert policies_for(path) == []


@pytest.mark.parametrize(
    "path", ["/api/v1/drives/a/b/run", "/api/v1//stop", "/api/v1/stop/", "/I18N/en.json", "/i18n/enXjson"]
)
def test_s02_an_address_that_only_looks_like_one_is_none(path: str) -> None:
    assert policies_for(path) == []


BAD = {
    "nothing": {},
    "a forged cookie": {"cookie": "drivebus_session=" + "A" * 43, "x-drivebus-csrf": "A" * 32},
    "a forged token": {"authorization": "Bearer dbt_" + "A" * 43},
    "another scheme": {"authorization": "Basic YWRtaW46YWRtaW4="},
    "an empty token": {"authorization": "Bearer "},
}


@pytest.mark.parametrize("kind", BAD)
def test_s01_without_a_good_credential_every_address_is_401_and_asks_nothing(kind: str, tmp_path: Path) -> None:
    house = WebAppHarness(tmp_path)

    async def story() -> None:
        client = house.client(**BAD[kind])
        for entry in CLOSED:
            answer = await client.request(entry.method, address(entry))
            assert answer.status_code == 401, (entry, answer.text)
            assert answer.json()["error"]["kind"] == "NotAuthenticated"
        assert house.plant.calls == []
        told = [entry["target"] for entry, _ in house.plant.records if entry["what"] == "refused"]
        assert counted(house) == len(CLOSED)
        assert told[0] == f"POST {API_PREFIX}/logout"

    run(story())


def counted(house: WebAppHarness) -> int:
    """Refusals that the audit trail has, repetitions and what is still being counted among them."""
    refusals = house.denials
    told = sum(entry["params"]["times"] for entry, _ in house.plant.records if entry["what"] == "refused")
    return told + sum(refusals._counts.values())


async def expired_session(house: WebAppHarness) -> AsyncClient:
    client = await house.log_in("administrator")
    house.clock.now += 12 * 3600.0
    return client


async def ended_session(house: WebAppHarness) -> AsyncClient:
    client = await house.log_in("administrator")
    cookie = client.cookies["drivebus_session"]
    assert (await client.post("/api/v1/logout")).status_code == 200
    client.cookies.set("drivebus_session", cookie, domain="127.0.0.1")
    return client


async def session_of_one_removed(house: WebAppHarness) -> AsyncClient:
    client = await house.log_in("engineer")
    house.access.user_file.change(lambda register: register.without_user("engineer"))
    return client


async def expired_token(house: WebAppHarness) -> AsyncClient:
    secret = await house.token("administrator", *map(str, Right))
    house.clock.now += 86_400.0
    return house.client(authorization=f"Bearer {secret}")


async def withdrawn_token(house: WebAppHarness) -> AsyncClient:
    client = await house.log_in("administrator")
    made = (await client.post("/api/v1/tokens", json={"name": "t", "rights": ["view", "stop"], "days": 1})).json()
    assert (await client.delete(f"/api/v1/tokens/{made['token']['id']}")).status_code == 200
    return house.client(authorization=f"Bearer {made['secret']}")


@pytest.mark.parametrize(
    "spent", [expired_session, ended_session, session_of_one_removed, expired_token, withdrawn_token]
)
def test_s01_a_credential_that_is_spent_is_401_everywhere(spent, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    house = WebAppHarness(tmp_path)

    async def story() -> None:
        client = await spent(house)
        house.plant.calls.clear()
        for entry in CLOSED:
            answer = await client.request(entry.method, address(entry))
            assert answer.status_code == 401, (entry, answer.text)
        assert house.plant.calls == []

    run(story())


@pytest.mark.parametrize("role", list(Role))
def test_s01_a_role_reaches_what_its_rights_allow_and_nothing_more(role: Role, tmp_path: Path) -> None:
    house = WebAppHarness(tmp_path)

    async def story() -> None:
        client = await house.log_in(role)
        for entry in CLOSED:
            if not isinstance(entry.access, Right):
                continue
            house.plant.calls.clear()
            answer = await client.request(entry.method, address(entry))
            if entry.access in ROLE_RIGHTS[role]:
                assert answer.status_code not in (401, 403), (entry, answer.text)
            else:
                assert (answer.status_code, house.plant.calls) == (403, []), entry
        assert role is Role.ADMINISTRATOR or counted(house) > 0

    run(story())


@pytest.mark.parametrize("right", list(Right))
def test_s01_a_token_reaches_what_its_scope_says_though_its_user_may_more(right: Right, tmp_path: Path) -> None:
    house = WebAppHarness(tmp_path)

    async def story() -> None:
        client = house.client(authorization=f"Bearer {await house.token('administrator', right)}")
        for entry in CLOSED:
            house.plant.calls.clear()
            answer = await client.request(entry.method, address(entry))
            if entry.access is right:
                assert answer.status_code not in (401, 403), (entry, answer.text)
            else:
                assert (answer.status_code, house.plant.calls) == (403, []), entry

    run(story())


def test_s01_a_token_loses_what_its_user_loses(tmp_path: Path) -> None:
    house = WebAppHarness(tmp_path)

    async def story() -> None:
        client = house.client(authorization=f"Bearer {await house.token('engineer', 'view', 'stop', 'tune')}")
        admin = await house.log_in("administrator")
        path = "/api/v1/drives/fan-1/parameters/write"
        assert (await client.post(path, json={"values": {"F0.1": 1.0}})).status_code == 200
        assert (await admin.patch("/api/v1/users/engineer", json={"role": "operator"})).status_code == 200
        assert (await client.post(path, json={"values": {"F0.1": 1.0}})).status_code == 403
        assert (await client.post("/api/v1/stop")).status_code == 200
        assert (await admin.patch("/api/v1/users/engineer", json={"disabled": True})).status_code == 200
        assert (await client.post("/api/v1/stop")).status_code in (401, 403)

    run(story())


def test_s01_one_users_session_can_not_do_what_another_may(tmp_path: Path) -> None:
    """The actor is who the credential says, not who the request claims to be."""
    house = WebAppHarness(tmp_path)

    async def story() -> None:
        operator, engineer = await house.log_in("operator"), await house.log_in("engineer")
        operator.headers["X-Drivebus-CSRF"] = engineer.headers["X-Drivebus-CSRF"]
        assert (await operator.post("/api/v1/stop")).status_code == 403, "another's CSRF token"
        mine = (await engineer.post("/api/v1/tokens", json={"name": "t", "rights": ["view"]})).json()["token"]["id"]
        operator = await house.log_in("operator")
        assert (await operator.get("/api/v1/tokens")).json() == {"tokens": []}
        assert (await operator.delete(f"/api/v1/tokens/{mine}")).status_code == 404
        claims = {"user": "engineer", "role": "administrator", "x-user": "administrator", "x-forwarded-for": "::1"}
        await operator.post("/api/v1/stop", headers=claims)
        assert [(call[2].name, call[2].address) for call in house.plant.calls] == [("operator", "127.0.0.1")]

    run(story())


def test_s08_nobody_gains_rights_that_they_do_not_have(tmp_path: Path) -> None:
    house = WebAppHarness(tmp_path)

    async def story() -> None:
        operator = await house.log_in("operator")
        answer = await operator.post("/api/v1/tokens", json={"name": "t", "rights": ["view", "tune"]})
        assert answer.status_code == 403
        house.clock.now += 900.0
        answer = await operator.post("/api/v1/tokens", json={"name": "t", "rights": ["operate"]})
        assert answer.status_code == 403, "an idle session makes no key that wakes it"
        admin = await house.log_in("administrator")
        for change in ({"role": "viewer"}, {"disabled": True}):
            assert (await admin.patch("/api/v1/users/administrator", json=change)).status_code == 409
        assert (await admin.delete("/api/v1/users/administrator")).status_code == 409

    run(story())


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
        ("POST", "/login", {"name": "viewer", "password": {"$ne": ""}}),
        ("POST", "/login", None),
    ],
)
def test_s08_a_body_of_another_shape_is_refused_and_changes_nothing(
    method: str, path: str, body: object, tmp_path: Path
) -> None:
    house = WebAppHarness(tmp_path)

    async def story() -> None:
        admin = await house.log_in("administrator")
        before = house.access.database
        answer = await admin.request(method, f"/api/v1{path}", json=body)
        assert answer.status_code == 422, answer.text
        error = answer.json()["error"]
        assert error["text"].keys() == {"en", "zh"} and error["kind"] == "InvalidParameters"
        assert house.access.database == before

    run(story())


@pytest.mark.parametrize(
    ("body", "path", "chinese"),
    [
        ('{"name": "t", "rights": ["view"], "days": 0}', "days", "应不小于 1"),
        ('{"name": "t", "rights": ["fly"]}', "rights.0", "应为以下之一：'view'"),
        ("[1]", "", "应为对象"),
    ],
)
def test_s08_the_door_says_what_is_wrong_in_both_languages(body: str, path: str, chinese: str, tmp_path: Path) -> None:
    house = WebAppHarness(tmp_path)

    async def story() -> None:
        admin = await house.log_in("administrator")
        kind = {"content-type": "application/json"}
        error = (await admin.post("/api/v1/tokens", content=body, headers=kind)).json()["error"]
        told = error["params"]["faults"][0]
        assert (told["path"], told["expected"]["zh"][: len(chinese)]) == (path, chinese)
        assert chinese in error["text"]["zh"] and told["expected"]["en"] in error["text"]["en"]

    run(story())
