"""Routes of sessions, users and tokens, each with its audit record."""

from __future__ import annotations

import asyncio
import errno
import json
import os
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from httpx import AsyncClient

from drivebus.service.api.operations import Audit, Operation
from drivebus.service.auth.rights import Role
from drivebus.service.auth.sessions import SESSION_IDLE_TIMEOUT_S, SESSION_LIFETIME_S
from drivebus.testing.virtual_time import run
from drivebus.types import Json
from drivebus.values import Text
from drivebus.web.operations import WEB_OPERATIONS
from drivebus.web.service_health import HEALTH_INTERVAL_S
from fixtures.service import running_service
from fixtures.web_app import PASSWORD, WebAppHarness

DAY_MS = 86_400_000
NEW = "a quite new pass phrase"


@pytest.mark.parametrize("end", ["removed", "changed to viewer", "logged out"])
@pytest.mark.parametrize(
    ("method", "path", "body"),
    [
        ("POST", "/api/v1/users", {"name": "eve", "role": "engineer", "password": NEW}),
        ("DELETE", "/api/v1/users/engineer", {}),
        ("POST", "/api/v1/password", {"old": PASSWORD, "new": NEW}),
    ],
)
def test_a_right_that_ends_while_the_body_is_sent_slowly_is_no_right(
    method: str, path: str, body: Json, end: str, tmp_path: Path
) -> None:
    """A dismissed administrator could finish a request that had begun before, and keep an account of another name."""
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        another = replace(harness.auth.database.user("administrator"), name="chief")
        harness.auth.user_file.change(lambda database: database.with_user(another))
        client = await harness.log_in("administrator")
        changed = before = harness.auth.database

        async def slow_body() -> AsyncIterator[bytes]:
            nonlocal changed
            text = json.dumps(body).encode()
            yield text[:1]
            if end == "logged out":
                assert (await client.post("/api/v1/logout")).status_code == 200
            elif end == "removed":
                harness.auth.user_file.change(lambda database: database.without_user("administrator"))
            else:
                viewer = replace(before.user("administrator"), role=Role.VIEWER)
                harness.auth.user_file.change(lambda database: database.with_changed_user(viewer))
            changed = harness.auth.database
            yield text[1:]

        headers = {"Content-Type": "application/json"}
        answer = await client.request(method, path, content=slow_body(), headers=headers)
        assert answer.status_code == 401, answer.text
        assert harness.auth.database == changed

    run(scenario())


def audit_entries(harness: WebAppHarness, *excluded: str) -> list[tuple[str, str, str, Json, str]]:
    """Return actor, operation, target, parameters and outcome of the audit records, without ``excluded`` operations."""
    entries = [(who.name, entry) for entry, who in harness.service.records if entry["what"] not in excluded]
    return [(name, entry["what"], entry["target"], entry["params"], entry["outcome"]) for name, entry in entries]


async def done(client: AsyncClient, method: str, path: str, body: Any = None) -> Json:
    answer = await client.request(method, f"/api/v1{path}", json=body)
    assert answer.status_code == 200, answer.text
    found: Json = answer.json()
    return found


RECORDED_CHANGES: dict[str, Json] = {
    "password": {"old": PASSWORD, "new": NEW},
    "user.add": {"name": "eve", "role": "viewer", "password": NEW},
    "user.change": {"user": "viewer", "role": "engineer"},
    "user.remove": {"user": "viewer"},
    "token.add": {"name": "report", "rights": ["view"]},
    "token.remove": {},
}


@pytest.mark.parametrize(
    "operation",
    [operation for operation in WEB_OPERATIONS.values() if operation.audit is Audit.REQUIRED],
    ids=lambda operation: operation.name,
)
def test_a_change_that_requires_an_audit_record_is_recorded_or_not_made(operation: Operation, tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        admin = await harness.log_in("administrator")
        token = (await done(admin, "POST", "/tokens", {"name": "t", "rights": ["view"]}))["token"]["id"]
        params = {"token": token} if operation.name == "token.remove" else RECORDED_CHANGES[operation.name]
        path = operation.path.format(**params)
        body = {name: value for name, value in params.items() if name not in operation.path_params}
        before, harness.service.audit_fails = harness.auth.database, True
        answer = await admin.request(operation.method, f"/api/v1{path}", json=body)
        assert (answer.status_code, answer.json()["error"]["code"]) == (503, "auth.no_record")
        assert harness.auth.database == before
        harness.service.audit_fails = False
        await done(admin, operation.method, path, body)
        outcomes = [entry["outcome"] for entry, _ in harness.service.records if entry["what"] == operation.name]
        assert outcomes[-2:] == ["requested", "done"] and harness.auth.database != before

    run(scenario())


def test_the_health_check_needs_no_credential(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)
    assert run(done(harness.client(), "GET", "/health")) == {"ok": True, "write_failure_count": 0}


def test_the_health_check_shows_what_can_not_be_written_and_its_names_only_to_a_user(tmp_path: Path) -> None:
    """A supervisor saw {"ok": true} while nothing was recorded any more, then every stranger the names of files."""
    found: list[Json] = []

    async def scenario() -> None:
        async with running_service() as kit:
            harness = WebAppHarness(tmp_path, service=kit.service)
            stranger, user = harness.client(), await harness.log_in("viewer")
            for full in (True, False):
                error = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)) if full else None
                kit.history.problem = Text("the disk is full", "磁盘已满") if full else None
                kit.trail.error = kit.trail.checkpoint_error = kit.service.incidents.recorder.error = error
                await asyncio.sleep(6)
                found.extend([await done(client, "GET", "/health") for client in (stranger, user)])
                assert (await kit.call("drive.stop", drive="fan-1"))["outcome"]["status"] == "confirmed"

    run(scenario())
    names = ["audit.jsonl", "checkpoints.jsonl", "history", "incidents"]
    assert found == [
        {"ok": True, "write_failure_count": 4},
        {"ok": True, "write_failure_count": 4, "write_failures": names},
        {"ok": True, "write_failure_count": 0},
        {"ok": True, "write_failure_count": 0, "write_failures": []},
    ]


def test_the_health_check_fails_while_the_service_does_not_answer_and_asks_it_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    harness = WebAppHarness(tmp_path)
    asked: list[str] = []

    async def hang(operation: str, params: object, actor: object) -> bytes:
        asked.append(operation)
        await asyncio.Event().wait()
        return b""

    async def scenario() -> None:
        monkeypatch.setattr(harness.service, "call_json", hang)
        answers = await asyncio.gather(*(harness.client().get("/api/v1/health") for _ in range(20)))
        assert {(answer.status_code, answer.text) for answer in answers} == {(503, '{"ok":false}')}
        assert asked == ["plant.get"]
        await asyncio.sleep(HEALTH_INTERVAL_S)
        assert (await harness.client().get("/api/v1/health")).status_code == 503
        assert len(asked) == 2

    run(scenario())


def test_every_login_and_logout_is_in_the_audit_trail(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client = await harness.log_in("operator")
        assert await done(client, "POST", "/logout") == {"ended": 1}
        code = await harness.auth.issue_code("viewer", 60)
        viewer = harness.client()
        found = await done(viewer, "POST", "/login/code", {"code": code})
        viewer.headers["X-Drivebus-CSRF"] = found["csrf"]
        await harness.log_in("viewer")
        await done(viewer, "POST", "/session/unlock", {"password": PASSWORD})
        found = await done(viewer, "POST", "/password", {"old": PASSWORD, "new": NEW})
        viewer.headers["X-Drivebus-CSRF"] = found["csrf"]
        assert await done(viewer, "POST", "/logout?all=true") == {"ended": 1}
        assert audit_entries(harness) == [
            ("operator", "login", "operator", {}, "done"),
            ("operator", "logout", "operator", {}, "done"),
            ("viewer", "login-code", "viewer", {}, "done"),
            ("viewer", "login", "viewer", {}, "done"),
            ("viewer", "unlock", "viewer", {}, "done"),
            ("viewer", "password", "viewer", {}, "requested"),
            ("viewer", "password", "viewer", {}, "done"),
            ("viewer", "logout", "viewer", {"sessions": 1}, "done"),
        ]

    run(scenario())


def test_every_failed_login_is_in_the_audit_trail_with_its_reason(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client = await harness.log_in("operator")
        harness.service.records.clear()
        tries: list[tuple[str, Json, int]] = [
            ("login", {"name": "operator", "password": "wrong"}, 401),
            ("login/code", {"code": "guess"}, 401),
            ("setup", {"secret": "x", "name": "eve", "password": PASSWORD}, 409),
            ("session/unlock", {"password": "wrong"}, 403),
            ("password", {"old": "wrong", "new": NEW}, 403),
        ]
        for path, body, status in tries:
            assert (await client.post(f"/api/v1/{path}", json=body)).status_code == status
        assert [
            (name, what, target, params.get("who"), why) for name, what, target, params, why in audit_entries(harness)
        ] == [
            ("operator", "refused", "login operator", "operator@127.0.0.1", "auth.wrong_password"),
            ("", "refused", "login-code ", "@127.0.0.1", "auth.wrong_code"),
            ("", "refused", "set-up eve", "@127.0.0.1", "auth.is_set_up"),
            ("operator", "refused", "unlock operator", "operator@127.0.0.1", "auth.wrong_password"),
            ("operator", "password", "operator", None, "requested"),
            ("operator", "password", "operator", None, "auth.wrong_password"),
        ]
        assert all(who.rights == frozenset() for entry, who in harness.service.records if entry["what"] == "refused")

    run(scenario())


OWN = {"own_password": PASSWORD}
CREDENTIALS: dict[str, tuple[str, Json, str]] = {
    "login": ("POST /login", {"name": "operator", "password": PASSWORD}, "password"),
    "login-code": ("POST /login/code", {"code": "{code}"}, "code"),
    "set-up": ("POST /setup", {"secret": "{setup}", "name": "ann", "password": NEW}, "secret"),
    "unlock": ("POST /session/unlock", {"password": PASSWORD}, "password"),
    "password": ("POST /password", {"old": PASSWORD, "new": NEW}, "old"),
    "session.end": ("POST /sessions/{session}/end", {"password": PASSWORD}, "password"),
    "user.add": ("POST /users", {"name": "eve", "role": "administrator", "password": NEW} | OWN, "own_password"),
    "user.change": ("PATCH /users/viewer", {"role": "administrator"} | OWN, "own_password"),
}
"""Request of each operation that checks a password, code or secret, and the name of the field with it."""


@pytest.mark.parametrize("operation", CREDENTIALS)
def test_every_operation_with_a_secret_is_recorded_whether_it_succeeds_or_fails(operation: str, tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path, users=operation != "set-up")
    request, body, secret = CREDENTIALS[operation]
    method, path = request.split()

    async def scenario() -> None:
        values = {"{code}": "", "{session}": "", "{setup}": ""}
        client = harness.client()
        if operation == "set-up":
            values["{setup}"] = harness.auth.setup_secret.issue()
        else:
            client = await harness.log_in("administrator")
            values["{code}"] = await harness.auth.issue_code("viewer", 60)
            await harness.log_in("administrator")
            sessions = (await done(client, "GET", "/sessions"))["sessions"]
            values["{session}"] = next(each["id"] for each in sessions if not each["current"])
        harness.service.records.clear()
        address = f"/api/v1{path.replace('{session}', values['{session}'])}"
        good = {name: values.get(value, value) for name, value in body.items()}
        wrong = await client.request(method, address, json=good | {secret: "wrong"})
        assert wrong.status_code in (401, 403), wrong.text
        assert [outcome for *_, outcome in audit_entries(harness)][-1].startswith("auth.wrong_")
        right = await client.request(method, address, json=good)
        assert right.status_code == 200, right.text
        *_, (_, what, _, _, outcome) = audit_entries(harness)
        assert (what, outcome) == (operation, "done")

    run(scenario())


def test_the_operations_with_a_secret_are_all_played_above() -> None:
    fields = {secret for *_, secret in CREDENTIALS.values()}
    assert CREDENTIALS.keys() == {
        name for name, operation in WEB_OPERATIONS.items() if fields & operation.params.model_fields.keys()
    }


def test_every_change_of_a_user_is_in_the_audit_trail(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        admin = await harness.log_in("administrator")
        made = await done(admin, "POST", "/users", {"name": "Bob", "role": "viewer", "password": PASSWORD})
        bob = {"name": "bob", "created_ms": harness.clock.wall_ms(), "sessions": 0, "tokens": 0}
        assert made == {"user": bob | {"role": "viewer", "disabled": False}}
        changed = await done(admin, "PATCH", "/users/bob", {"role": "operator", "password": NEW})
        assert changed == {"user": bob | {"role": "operator", "disabled": False}}
        await done(admin, "PATCH", "/users/bob", {"disabled": True, "end_sessions": False, "password": None})
        assert await done(admin, "DELETE", "/users/bob") == {}
        assert harness.auth.database.find("bob") is None
        changes: list[tuple[str, str, Json]] = [
            ("user.add", "Bob", {"role": "viewer"}),
            ("user.change", "bob", {"role": "operator", "password": "new"}),
            ("user.change", "bob", {"disabled": True, "end_sessions": False}),
            ("user.remove", "bob", {}),
        ]
        assert audit_entries(harness, "login") == [
            ("administrator", *change, outcome) for change in changes for outcome in ("requested", "done")
        ]

    run(scenario())


@pytest.mark.parametrize("way", ["password", "token"])
def test_a_flood_of_changes_of_the_own_account_is_counted_beyond_a_budget(
    way: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A viewer could fill the disk: each wrong change of the own password was two records, and so was each token."""
    monkeypatch.setattr("drivebus.service.api.record_budget.MAX_BURST_OCTETS", 20_000)
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        viewer = await harness.log_in("viewer")
        path, body = "/password", {"old": "wrong " + PASSWORD, "new": NEW}
        if way == "token":
            path, body = "/tokens", {"name": "report", "rights": ["view"]}
        answers = [await viewer.post(f"/api/v1{path}", json=body) for _ in range(40)]
        refused = [
            answer for answer in answers if answer.status_code == 429 and "plant.too_many_commands" in answer.text
        ]
        if way == "token":
            assert answers[-1] in refused
            assert int(refused[-1].headers["retry-after"]) >= 1
        else:
            assert not refused, "a change of the password withdraws the access of others"
        written = len(harness.service.records)
        assert written < 60
        await harness.aggregator.flush()
        (counted,) = (entry for entry, _ in harness.service.records[written:])
        what = path.removeprefix("/") if way == "password" else "token.add"
        singly = [entry["outcome"] for entry, _ in harness.service.records if entry["what"] == what].count("requested")
        times = len(refused) - 1 if refused else len(answers) - singly
        assert counted["params"] == {"who": "viewer@127.0.0.1", "times": times}, "none is lost"
        assert (await viewer.get("/api/v1/session")).json()["user"] == "viewer", "the session goes on"

    run(scenario())


def test_changes_that_withdraw_access_are_never_refused_as_too_many(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stolen token kept its owner from removing it, and from changing the password."""
    monkeypatch.setattr("drivebus.service.api.record_budget.MAX_BURST_OCTETS", 20_000)
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        administrator = await harness.log_in("administrator")
        stolen = harness.client(authorization=f"Bearer {await harness.token('administrator', 'administer')}")
        for client in (stolen, administrator):
            for _ in range(60):
                last = await client.patch("/api/v1/users/missing", json={"role": "viewer"})
            assert last.json()["error"]["code"] == "plant.too_many_commands", "one budget for tokens, one for sessions"
        for client in (stolen, administrator):
            for body in ({"disabled": True}, {"end_sessions": True}):
                assert (await client.patch("/api/v1/users/viewer", json=body)).status_code == 200
        for body in ({"disabled": False}, {"disabled": True, "role": "viewer"}, {"password": NEW}):
            assert (await administrator.patch("/api/v1/users/viewer", json=body)).status_code == 429
        assert (await administrator.delete("/api/v1/users/operator")).status_code == 200
        (token,) = (await administrator.get("/api/v1/tokens")).json()["tokens"]
        assert (await administrator.delete(f"/api/v1/tokens/{token['id']}")).status_code == 200
        changed = await administrator.post("/api/v1/password", json={"old": PASSWORD, "new": NEW})
        assert changed.status_code == 200
        recorded = [entry["target"] for entry, _ in harness.service.records if entry["what"] == "token.remove"]
        assert recorded == [token["id"]], "the first of them in a period is in the trail"

    run(scenario())


@pytest.mark.parametrize("name", ["administrator", "ADMINISTRATOR"])
@pytest.mark.parametrize("by_token", [False, True])
def test_an_administrator_cannot_change_the_own_role(by_token: bool, name: str, tmp_path: Path) -> None:
    """Another spelling of the name or an own token does not allow it; the own password needs the present one."""
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        admin, path = await harness.log_in("administrator"), f"/api/v1/users/{name}"
        second = {"name": "second", "role": "administrator", "password": PASSWORD, "own_password": PASSWORD}
        await done(admin, "POST", "/users", second)
        if by_token:
            admin = harness.client(authorization=f"Bearer {await harness.token('administrator', 'administer')}")
        for method, body in (("PATCH", {"role": "viewer"}), ("PATCH", {"disabled": True}), ("DELETE", None)):
            answer = await admin.request(method, path, json=body)
            assert (answer.status_code, answer.json()["error"]["code"]) == (409, "auth.oneself")
        assert harness.auth.database.user("administrator").role == "administrator"
        answer = await admin.patch(path, json={"password": NEW})
        assert (answer.status_code, answer.json()["error"]["code"]) == (409, "auth.own_password")

    run(scenario())


ADMINISTRATOR_CHANGES: list[tuple[str, str, Json]] = [
    ("POST", "/users", {"name": "eve", "role": "administrator", "password": NEW}),
    ("PATCH", "/users/operator", {"role": "administrator"}),
    ("PATCH", "/users/second", {"password": NEW}),
    ("PATCH", "/users/second", {"disabled": False}),
]


@pytest.mark.parametrize(("method", "path", "body"), ADMINISTRATOR_CHANGES)
def test_a_new_administrator_needs_the_password_of_the_one_who_makes_it(
    method: str, path: str, body: Json, tmp_path: Path
) -> None:
    """A page that was left open is not enough, and a token has no password."""
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        admin = await harness.log_in("administrator")
        second = {"name": "second", "role": "administrator", "password": PASSWORD, "own_password": PASSWORD}
        await done(admin, "POST", "/users", second)
        by_token = harness.client(authorization=f"Bearer {await harness.token('administrator', 'administer')}")
        before = harness.auth.database
        for client, own, code in (
            (admin, {}, (422, "auth.own_password_needed")),
            (admin, {"own_password": "wrong password"}, (403, "auth.wrong_password")),
            (by_token, {"own_password": PASSWORD}, (403, "auth.only_session")),
        ):
            answer = await client.request(method, f"/api/v1{path}", json=body | own)
            assert (answer.status_code, answer.json()["error"]["code"]) == code
        assert harness.auth.database == before
        await done(admin, method, path, body | {"own_password": PASSWORD})
        assert PASSWORD not in repr(harness.service.records)

    run(scenario())


def test_a_changed_user_stays_logged_in_and_one_who_loses_rights_is_logged_out(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        admin, client = await harness.log_in("administrator"), await harness.log_in("operator")
        (session,) = harness.auth.sessions.of_user("operator")
        await done(admin, "PATCH", "/users/operator", {})
        assert session.end_reason is None
        await done(admin, "PATCH", "/users/operator", {"end_sessions": True})
        assert (session.end_reason, harness.auth.sessions.of_user("operator")) == ("ended", []), "at once"
        client = await harness.log_in("operator")
        (session,) = harness.auth.sessions.of_user("operator")
        assert (await client.get("/api/v1/drives")).status_code == 200
        await done(admin, "PATCH", "/users/operator", {"role": "viewer"})
        assert (session.end_reason, harness.auth.sessions.of_user("operator")) == ("role", []), "at once"
        await harness.log_in("operator")
        (session,) = harness.auth.sessions.of_user("operator")
        await done(admin, "DELETE", "/users/operator")
        assert (session.end_reason, harness.auth.sessions.of_user("operator")) == ("removed", []), "at once"

    run(scenario())


def test_a_users_sessions_and_tokens_are_counted_as_the_users_own(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        await harness.token("operator", "view")
        await harness.token("operator", "view")
        admin = await harness.log_in("administrator")
        users = (await done(admin, "GET", "/users"))["users"]
        counted = {user["name"]: (user["sessions"], user["tokens"]) for user in users}
        assert counted == {"viewer": (0, 0), "operator": (2, 2), "engineer": (0, 0), "administrator": (1, 0)}

    run(scenario())


def test_a_user_sees_and_ends_the_own_sessions_with_the_password(tmp_path: Path) -> None:
    """The session of a lost telephone could be ended only together with all others."""
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        lost, mine = await harness.log_in("operator"), await harness.log_in("operator")
        other = await harness.log_in("engineer")
        harness.clock.now += 60.0
        found = (await done(mine, "GET", "/sessions"))["sessions"]
        assert [session["current"] for session in found] == [False, True]
        assert {session["opened_ms"] for session in found} == {harness.clock.wall_ms() - 60_000}
        assert {session["address"] for session in found} == {"127.0.0.1"}
        path = f"/api/v1/sessions/{found[0]['id']}/end"
        assert (await mine.post(path, json={"password": "wrong password"})).status_code == 403
        assert (await other.post(path, json={"password": PASSWORD})).status_code == 404
        assert (await lost.get("/api/v1/drives")).status_code == 200
        await done(mine, "POST", f"/sessions/{found[0]['id']}/end", {"password": PASSWORD})
        assert (await lost.get("/api/v1/drives")).status_code == 401
        assert [session["id"] for session in (await done(mine, "GET", "/sessions"))["sessions"]] == [found[1]["id"]]
        assert ("operator", "session.end", found[0]["id"], {}, "done") in audit_entries(harness, "login")
        await done(mine, "POST", f"/sessions/{found[1]['id']}/end", {"password": PASSWORD})
        assert (await mine.get("/api/v1/drives")).status_code == 401

    run(scenario())


def test_a_login_reports_how_many_wrong_passwords_came_before_it(tmp_path: Path) -> None:
    """A user could not notice that others guess at the password."""
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        for name, count in (("operator", 3), ("viewer", 1), ("eve", 5)):
            for _ in range(count):
                await harness.client().post("/api/v1/login", json={"name": name, "password": "wrong password"})
        assert set(harness.auth.failed_logins) == {"operator", "viewer"}, "invented names take no memory"
        client = await harness.log_in("operator")
        assert (await done(client, "GET", "/session"))["failed_logins"] == 3
        again = await harness.log_in("operator")
        assert "failed_logins" not in await done(again, "GET", "/session")

    run(scenario())


def test_a_session_that_is_too_old_is_not_listed(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        await harness.log_in("operator")
        harness.clock.now += SESSION_LIFETIME_S
        client = await harness.log_in("operator")
        assert len((await done(client, "GET", "/sessions"))["sessions"]) == 1

    run(scenario())


def test_a_token_has_the_requested_rights_and_expires_on_its_date(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client = await harness.log_in("operator")
        body = {"name": "scada", "rights": ["view", "stop", "view"], "days": 30}
        made = await done(client, "POST", "/tokens", body)
        token, now_ms = made["token"], harness.clock.wall_ms()
        assert token == {
            "id": token["id"],
            "name": "scada",
            "user": "operator",
            "rights": ["stop", "view"],
            "created_ms": now_ms,
            "expires_ms": now_ms + 30 * DAY_MS,
        }
        assert len(token["id"]) == 12 and made["secret"].startswith("dbt_") and len(made["secret"]) == 47
        assert await done(client, "GET", "/tokens") == {"tokens": [token]}
        assert await done(client, "DELETE", f"/tokens/{token['id']}") == {}
        assert harness.auth.database.tokens == ()
        params = {"name": "scada", "rights": ["stop", "view"], "days": 30}
        changes = [("token.add", token["id"], params), ("token.remove", token["id"], {})]
        assert audit_entries(harness, "login") == [
            ("operator", *change, outcome) for change in changes for outcome in ("requested", "done")
        ]
        usual = await done(client, "POST", "/tokens", {"name": "t", "rights": ["view"]})
        assert usual["token"]["expires_ms"] == now_ms + 90 * DAY_MS
        whole = await done(client, "POST", "/tokens", body | {"days": 30.0})
        assert whole["token"]["expires_ms"] == token["expires_ms"], "JSON has one kind of number"
        for days in (30.5, 0, 367, True, "30"):
            assert (await client.post("/api/v1/tokens", json=body | {"days": days})).status_code == 422
        answer = await client.post("/api/v1/tokens", json=body | {"rights": ["view", "write_parameters", "audit"]})
        assert answer.json()["error"]["code"] == "auth.beyond_own"
        assert answer.json()["error"]["params"] == {"rights": ["audit", "write_parameters"]}

    run(scenario())


def test_an_administrator_sees_and_revokes_the_tokens_of_all_users(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        await harness.token("operator", "view")
        admin, other = await harness.log_in("administrator"), await harness.log_in("engineer")
        ((token,),) = (await done(admin, "GET", "/tokens")).values()
        assert await done(other, "GET", "/tokens") == {"tokens": []}
        refused = await other.delete(f"/api/v1/tokens/{token['id']}")
        assert (refused.status_code, refused.json()["error"]["code"]) == (404, "auth.no_such_token")
        assert audit_entries(harness, "login", "token.add") == [], "there is no such token for that one"
        await done(admin, "DELETE", f"/tokens/{token['id']}")
        assert harness.auth.database.tokens == ()

    run(scenario())


def test_the_session_answer_has_the_user_and_the_remaining_times(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)
    no_user = {"setup": False, "users_missing": None, "user": None, "rights": [], "csrf": None}

    async def scenario() -> None:
        assert await done(harness.client(), "GET", "/session") == no_user
        client = await harness.log_in("operator")
        harness.clock.now += 0.25
        found = await done(client, "GET", "/session")
        (session,) = harness.auth.sessions.of_user("operator")
        assert found == {
            "setup": False,
            "users_missing": None,
            "user": "operator",
            "rights": ["view", "stop", "operate"],
            "session": session.id,
            "role": "operator",
            "csrf": session.csrf,
            "idle": False,
            "idle_in_s": SESSION_IDLE_TIMEOUT_S - 0.2,
            "expires_in_s": SESSION_LIFETIME_S - 0.2,
        }
        harness.clock.now += SESSION_IDLE_TIMEOUT_S + 60
        found = await done(client, "POST", "/session/activity")
        assert (found["idle"], found["idle_in_s"], found["rights"]) == (True, 0.0, ["view", "stop"])
        token = harness.client(authorization=f"Bearer {await harness.token('operator', 'view')}")
        session = await done(token, "GET", "/session")
        assert (session.keys(), session["user"]) == ({*no_user, "session"}, "operator/t")

    run(scenario())


def test_a_session_that_another_login_replaces_is_gone_after_a_crash_too(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client = await harness.log_in("operator")
        (before,) = harness.auth.sessions.of_user("operator")
        await done(client, "POST", "/login", {"name": "viewer", "password": PASSWORD})
        assert before.end_reason == "replaced"
        assert [session.user for session in harness.auth.session_store.read()] == ["viewer"]

    run(scenario())


@pytest.mark.parametrize("path", ["/logout", "/logout?all=true"])
def test_a_logout_deletes_the_cookies(path: str, tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client = await harness.log_in("operator")
        (session,) = harness.auth.sessions.of_user("operator")
        gone = await client.post(f"/api/v1{path}")
        assert session.end_reason == "logout", "the reason that an open page shows"
        lines = gone.headers.get_list("set-cookie")
        assert [line.partition("=")[0] for line in lines] == ["__Host-drivebus", "drivebus_session"]
        for line, secure in zip(lines, (True, False), strict=True):
            assert {"Max-Age=0", "HttpOnly", "SameSite=strict", "Path=/"} <= set(line.split("; "))
            assert ("Secure" in line) is secure

    run(scenario())
