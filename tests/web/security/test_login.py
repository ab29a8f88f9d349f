"""Login: throttling, first start, cookies, idle sessions."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest
from starlette.datastructures import Headers

from drivebus.service.api.audit_aggregator import MAX_KINDS_PER_PERIOD, SUMMARY_PERIOD_S
from drivebus.service.api.errors import localized
from drivebus.service.auth.devices import DeviceCookies, device_cookie_name
from drivebus.service.auth.rights import AccessLevel
from drivebus.service.auth.sessions import REPLACED_SECRET_LIFETIME_S, SESSION_IDLE_TIMEOUT_S
from drivebus.testing.virtual_time import run
from drivebus.values import Text
from drivebus.web.app import declared_routes
from drivebus.web.gateway import WebConfig
from drivebus.web.middleware.trusted_proxies import TrustedProxies
from drivebus.web.route import WEBSOCKET
from fixtures.web_app import BASE, PASSWORD, USERS, WebAppHarness

HOUR_S = 3600.0


async def guess(harness: WebAppHarness, name: str, host: str = "10.0.0.9") -> int:
    """Return the status of a login with a wrong password, from its own address."""
    import httpx

    transport = httpx.ASGITransport(app=harness.app, client=(host, 40000))
    async with httpx.AsyncClient(transport=transport, base_url=BASE) as client:
        answer = await client.post("/api/v1/login", json={"name": name, "password": "wrong password"})
        if answer.status_code == 429:
            assert int(answer.headers["retry-after"]) >= 1
            assert answer.json()["error"]["params"]["retry_s"] > 0
        return answer.status_code


def test_a_user_can_stop_drives_during_an_hour_of_guesses_at_the_password(tmp_path: Path) -> None:
    """Of 1,200 guesses from 1,200 addresses at most 100 are checked; stops of the logged-in user are not delayed."""
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        mine = await harness.log_in("operator")
        looked_at = 0
        for n in range(1200):
            harness.clock.now += HOUR_S / 1200
            looked_at += await guess(harness, "operator", f"10.{n >> 8}.{n & 255}.1") == 401
            if n % 120 == 0:
                assert (await mine.post("/api/v1/stop")).status_code == 200
                assert (await mine.post("/api/v1/session/activity")).status_code == 200
        assert 10 < looked_at <= 100
        assert [call[0] for call in harness.service.calls] == ["plant.stop"] * 10

    run(scenario())


def test_an_address_that_tries_names_is_throttled_and_others_are_not(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        statuses = [await guess(harness, f"user{n}") for n in range(300)]
        assert statuses.count(401) == 10
        await harness.log_in("operator")

    run(scenario())


def test_throttled_logins_do_not_fill_the_audit_trail(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        for n in range(500):
            await guess(harness, f"user{n % 100}")
        message = [entry for entry, _ in harness.service.records if entry["what"] == "refused"]
        assert {entry["outcome"] for entry in message} == {"auth.wrong_password", "auth.too_many"}
        assert len(message) <= 1 + MAX_KINDS_PER_PERIOD
        await asyncio.sleep(SUMMARY_PERIOD_S + 1)
        message = [entry for entry, _ in harness.service.records if entry["what"] == "refused"]
        assert sum(entry["params"]["times"] for entry in message) == 500

    run(scenario())


def test_logins_under_ever_new_names_from_many_addresses_do_not_fill_the_audit_trail(tmp_path: Path) -> None:
    """The names are chosen by clients without an account: they are no users whose requests are counted apart."""
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        assert {await guess(harness, f"user{n}", f"10.0.0.{n}") for n in range(200)} == {401}
        await asyncio.sleep(SUMMARY_PERIOD_S + 1)
        denials = [entry for entry, _ in harness.service.records if entry["what"] == "refused"]
        assert sum(entry["params"]["times"] for entry in denials) == 200
        assert len(denials) == MAX_KINDS_PER_PERIOD + 1, "the first kinds, and one count of the others"

    run(scenario())


def test_a_flood_of_other_requests_does_not_hide_whose_password_is_guessed(tmp_path: Path) -> None:
    """Their kinds filled the period, and the guesses were counted without the name of the account."""
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        for n in range(MAX_KINDS_PER_PERIOD + 4):
            await guess(harness, f"user{n}", f"10.0.0.{n}")
        for _ in range(3):
            await guess(harness, "operator", "10.0.1.1")
        await asyncio.sleep(SUMMARY_PERIOD_S + 1)
        denials = [entry for entry, _ in harness.service.records if entry["what"] == "refused"]
        guesses = [entry["params"] for entry in denials if entry["params"]["who"] == "operator"]
        assert [params["times"] for params in guesses] == [3]

    run(scenario())


def test_a_person_with_a_known_browser_logs_in_however_often_others_try_the_name(tmp_path: Path) -> None:
    """That holds where all clients have the address of a reverse proxy, and where the wrong attempts never end."""
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        mine = await harness.log_in("operator")
        body = {"name": "operator", "password": PASSWORD}
        for n in range(1200):
            harness.clock.now += 0.05
            await guess(harness, "operator", "127.0.0.1" if n % 2 else f"10.0.{n >> 8}.{n & 255}")
            if n % 120 == 119:
                assert (await mine.post("/api/v1/login", json=body)).status_code == 200
                assert (await harness.client().post("/api/v1/login", json=body)).status_code == 429
        mine.cookies.delete("drivebus_session")
        assert (await mine.post("/api/v1/login", json=body)).status_code == 200, "also after the session has ended"

    run(scenario())


def test_a_device_cookie_is_counted_on_its_own_and_is_of_one_user(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        mine = await harness.log_in("operator")
        cookie = mine.cookies[device_cookie_name("operator")]
        tries = [await mine.post("/api/v1/login", json={"name": "operator", "password": f"{n}"}) for n in range(12)]
        assert [answer.status_code for answer in tries] == [401] * 10 + [429] * 2
        await harness.log_in("operator")
        for _ in range(10):
            await guess(harness, "engineer")
        for value in (cookie, cookie[:-1] + ("0" if cookie[-1] != "0" else "1"), "x", ""):
            other = harness.client(cookie=f"{device_cookie_name('engineer')}={value}")
            answer = await other.post("/api/v1/login", json={"name": "engineer", "password": PASSWORD})
            assert answer.status_code == 429, value

    run(scenario())


def test_a_browser_stays_known_when_the_web_process_starts_again(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        mine = await harness.log_in("operator")
        cookie = mine.cookies[device_cookie_name("operator")]
        again = DeviceCookies(tmp_path)
        assert again.device("Operator", cookie) and not again.device("engineer", cookie)
        assert again.issue("operator", cookie) == cookie != again.issue("operator")
        assert again.path.stat().st_mode & 0o777 == 0o600

    run(scenario())


def test_behind_a_trusted_proxy_each_client_is_counted_and_recorded_by_its_own_address(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path, web=WebConfig(trusted_proxies=("127.0.0.1",)))

    async def scenario() -> None:
        client, body = harness.client(), {"name": "operator", "password": "wrong password"}
        for n in range(30):
            forged = {"x-forwarded-for": f"10.9.9.{n}, 10.0.0.9"}
            await client.post("/api/v1/login", json=body | {"name": f"user{n}"}, headers=forged)
        assert (await client.post("/api/v1/login", json=body, headers=forged)).status_code == 429
        answer = await client.post(
            "/api/v1/login", json=body | {"password": PASSWORD}, headers={"x-forwarded-for": "10.0.0.7"}
        )
        assert answer.status_code == 200
        assert {actor.address for _, actor in harness.service.records} == {"10.0.0.9", "10.0.0.7"}

    run(scenario())


FORWARDED = [
    ("127.0.0.1", ["10.0.0.7"], "10.0.0.7"),
    ("127.0.0.1", [], "127.0.0.1"),
    ("10.0.0.9", ["10.0.0.7"], "10.0.0.9"),
    ("127.0.0.1", ["1.1.1.1, 10.0.0.7, 192.168.0.3"], "10.0.0.7"),
    ("127.0.0.1", ["1.1.1.1", "10.0.0.7"], "10.0.0.7"),
    ("127.0.0.1", ["192.168.0.4, 192.168.0.3"], "192.168.0.4"),
    ("::ffff:127.0.0.1", ["::ffff:10.0.0.7"], "10.0.0.7"),
    ("127.0.0.1", ["10.0.0.7:4711"], "10.0.0.7"),
    ("127.0.0.1", ["[2001:db8::7]:4711"], "2001:db8::7"),
    ("127.0.0.1", ["2001:db8::7"], "2001:db8::7"),
    ("127.0.0.1", ["10.0.0.7, unknown"], "127.0.0.1"),
    ("127.0.0.1", ["fe80::1%x y\tz"], "127.0.0.1"),
    ("127.0.0.1", ["[fe80::1%eth0]:4711"], "127.0.0.1"),
    ("127.0.0.1", ["fe80::1%x y\tz, 192.168.0.3"], "192.168.0.3"),
    ("local", ["10.0.0.7"], "local"),
]


@pytest.mark.parametrize(("peer", "lines", "expected"), FORWARDED)
def test_the_client_is_the_last_address_that_no_trusted_proxy_has(peer: str, lines: list[str], expected: str) -> None:
    headers = Headers(raw=[(b"x-forwarded-for", line.encode()) for line in lines])
    assert TrustedProxies(["127.0.0.1", "192.168.0.0/24"]).client_address(peer, headers) == expected


def test_a_trusted_proxy_may_have_a_link_local_address_with_its_interface() -> None:
    headers = Headers(raw=[(b"x-forwarded-for", b"10.0.0.7")])
    assert TrustedProxies(["fe80::1"]).client_address("fe80::1%eth0", headers) == "10.0.0.7"


def test_before_the_set_up_only_the_set_up_is_reachable(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path, users=False)

    async def scenario() -> None:
        client = harness.client()
        for entry in declared_routes():
            if entry.access is AccessLevel.PUBLIC or entry.method == WEBSOCKET:
                continue
            for headers in ({}, {"authorization": "Bearer x"}, {"cookie": "drivebus_session=x"}):
                answer = await client.request(entry.method, entry.path, headers=headers)
                assert (answer.status_code, answer.json()["error"]["code"]) == (409, "auth.setup_needed"), entry
        assert harness.service.calls == []
        for name, password in (("admin", "admin"), ("administrator", "administrator"), ("drivebus", "drivebus")):
            answer = await client.post("/api/v1/login", json={"name": name, "password": password})
            assert answer.status_code == 401
        assert (await client.get("/api/v1/session")).json()["setup"] is True

    run(scenario())


def test_the_login_notice_is_public_and_absent_where_none_is_configured(tmp_path: Path) -> None:
    async def notice_of(web: WebConfig, name: str) -> object:
        client = WebAppHarness(tmp_path / name, web=web).client()
        return (await client.get("/api/v1/session")).json().get("login_notice")

    async def scenario() -> None:
        assert await notice_of(WebConfig(), "without") is None
        configured = WebConfig(login_notice=Text("authorized staff only", "仅限授权人员"))
        assert await notice_of(configured, "with") == {"en": "authorized staff only", "zh": "仅限授权人员"}

    run(scenario())


def test_the_set_up_secret_works_once(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path, users=False)

    async def scenario() -> None:
        client = harness.client()
        body = {"secret": "guess", "name": "ann", "password": PASSWORD}
        assert (await client.post("/api/v1/setup", json=body)).status_code == 401
        body["secret"] = harness.auth.setup_secret.issue()
        answer = await client.post("/api/v1/setup", json=body)
        assert (answer.status_code, answer.json()["role"]) == (200, "administrator")
        assert (await client.get("/api/v1/drives")).status_code == 200
        assert (await harness.client().post("/api/v1/setup", json=body)).status_code == 409
        assert [entry["what"] for entry, _ in harness.service.records] == ["refused", "set-up", "refused"]
        assert body["secret"] not in repr(harness.service.records) and PASSWORD not in repr(harness.service.records)

    run(scenario())


def test_missing_users_are_named_and_nothing_is_set_up_or_commanded(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        operator = await harness.log_in("operator")
        harness.auth.user_file.path.unlink()
        harness.auth.user_file.__init__(harness.auth.user_file.path)  # type: ignore[misc]  # as in a new process
        client = harness.client()
        found = (await client.get("/api/v1/session")).json()
        assert found["setup"] and found["users_missing"] == localized("auth.users_missing", {"file": "users.json"})
        assert str(tmp_path) not in found["users_missing"]["en"], "a stranger learns no path"
        body = {"secret": harness.auth.setup_secret.issue(), "name": "eve", "password": PASSWORD}
        for asking, method, path in (
            (client, "POST", "/api/v1/setup"),
            (client, "GET", "/api/v1/drives"),
            (operator, "POST", "/api/v1/drives/fan-1/run"),
        ):
            answer = await asking.request(method, path, **({"json": body} if method == "POST" else {}))
            assert (answer.status_code, answer.json()["error"]["code"]) == (409, "auth.users_missing"), path
        harness.auth.user_file.change(lambda _: USERS)
        assert (await client.get("/api/v1/session")).json()["users_missing"] is None

    run(scenario())


def test_before_the_set_up_an_operator_may_only_stop(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client = await harness.log_in("operator")
        harness.auth.user_file.change(lambda register: type(register)(register.users[:2]))
        assert harness.auth.needs_setup
        assert (await client.post("/api/v1/drives/fan-1/run", json={"frequency_hz": 5})).status_code == 409
        assert (await client.post("/api/v1/stop")).status_code == 200

    run(scenario())


def test_a_login_makes_a_new_secret_and_ends_the_old_one(tmp_path: Path) -> None:
    """A secret that an attacker set before the login is invalid after it."""
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client = await harness.log_in("operator")
        before = client.cookies["drivebus_session"]
        answer = await client.post("/api/v1/login", json={"name": "engineer", "password": PASSWORD})
        after = answer.cookies["drivebus_session"]
        assert before != after and harness.auth.session_credential(before) is None
        planted = harness.client(cookie="drivebus_session=planted")
        answer = await planted.post("/api/v1/login", json={"name": "engineer", "password": PASSWORD})
        assert answer.cookies["drivebus_session"] != "planted"

    run(scenario())


@pytest.mark.parametrize(
    ("base", "name", "secure"), [(BASE, "drivebus_session", False), ("https://127.0.0.1:8080", "__Host-drivebus", True)]
)
def test_the_cookie_is_for_this_page_only(base: str, name: str, secure: bool, tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client = harness.client(base)
        answer = await client.post("/api/v1/login", json={"name": "operator", "password": PASSWORD})
        flags = {"HttpOnly", "SameSite=strict", "Path=/"} | ({"Secure"} if secure else set())
        device = ("__Host-" if secure else "") + device_cookie_name("operator")
        cookies = [line.split("; ") for line in answer.headers.get_list("set-cookie")]
        assert [first.partition("=")[0] for first, *_ in cookies] == [name, device]
        assert [set(rest) - flags for _, *rest in cookies] == [{"Max-Age=43200"}, {"Max-Age=31536000"}]
        assert all(flags <= set(rest) for _, *rest in cookies)
        assert ("strict-transport-security" in answer.headers) == secure
        client.headers["X-Drivebus-CSRF"] = answer.json()["csrf"]
        gone = await client.post("/api/v1/logout")
        assert all("Max-Age=0" in line for line in gone.headers.get_list("set-cookie"))

    run(scenario())


def test_after_fifteen_idle_minutes_a_session_can_only_view_and_stop(tmp_path: Path) -> None:
    """Requests that the page sends by itself (reads, renewals of leases) are not activity."""
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client = await harness.log_in("operator")
        run_it: dict[str, Any] = {"url": "/api/v1/drives/fan-1/run", "json": {"frequency_hz": 5.0}}
        for _ in range(15):
            harness.clock.now += 60
            assert (await client.get("/api/v1/drives")).status_code == 200
            assert (await client.post("/api/v1/drives/fan-1/lease/renew")).status_code == 200
        answer = await client.post(**run_it)
        assert (answer.status_code, answer.json()["error"]["code"]) == (403, "auth.idle")
        assert (await client.get("/api/v1/session")).json()["idle"] is True
        assert (await client.get("/api/v1/drives")).status_code == 200
        assert (await client.post("/api/v1/drives/fan-1/stop")).status_code == 200
        assert (await client.post("/api/v1/drives/fan-1/lease/renew")).status_code == 200
        assert (await client.post("/api/v1/session/activity")).json()["idle"] is True, "only a password unlocks it"
        again = await client.post("/api/v1/login", json={"name": "operator", "password": PASSWORD})
        client.headers["X-Drivebus-CSRF"] = again.json()["csrf"]
        assert (await client.post(**run_it)).status_code == 200

    run(scenario())


def test_a_password_unlocks_an_idle_session_which_stays_the_same_one(tmp_path: Path) -> None:
    """The leases of the session stay and its secret is new; a wrong password changes nothing and is counted."""
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client = await harness.log_in("operator")
        old, before = client.cookies["drivebus_session"], (await client.get("/api/v1/session")).json()
        harness.clock.now += SESSION_IDLE_TIMEOUT_S
        assert (await client.post("/api/v1/session/unlock", json={"password": "wrong password"})).status_code == 403
        assert (await client.post("/api/v1/stop")).status_code == 200
        unlocked = await client.post("/api/v1/session/unlock", json={"password": PASSWORD})
        after = unlocked.json()
        assert (after["idle"], after["session"], after["user"]) == (False, before["session"], "operator")
        assert after["csrf"] == before["csrf"], "another tab can stop at once"
        late = {"Cookie": f"drivebus_session={old}"}
        assert (await client.post("/api/v1/stop", headers=late)).status_code == 200, "a stop that was under way"
        refused = await client.post("/api/v1/drives/fan-1/run", json={"frequency_hz": 5.0}, headers=late)
        assert refused.json()["error"]["code"] == "auth.idle"
        harness.clock.now += REPLACED_SECRET_LIFETIME_S
        assert (await client.post("/api/v1/stop", headers=late)).status_code == 401
        answer = await client.post("/api/v1/drives/fan-1/run", json={"frequency_hz": 5.0})
        assert answer.status_code == 200 and harness.service.calls[-1][2].session == before["session"]
        harness.clock.now += 12 * 3600.0 - SESSION_IDLE_TIMEOUT_S - REPLACED_SECRET_LIFETIME_S
        assert (await client.get("/api/v1/drives")).status_code == 401, "twelve hours are twelve hours"
        message = [
            (entry["what"], entry["outcome"]) for entry, _ in harness.service.records if entry["what"] == "unlock"
        ]
        assert message == [("unlock", "done")]

    run(scenario())


def test_an_idle_session_is_not_unlocked_by_guessing(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client = await harness.log_in("operator")
        harness.clock.now += SESSION_IDLE_TIMEOUT_S
        guesses = [await client.post("/api/v1/session/unlock", json={"password": f"wrong {n}"}) for n in range(15)]
        assert [answer.status_code for answer in guesses] == [403] * 10 + [429] * 5
        assert (await client.post("/api/v1/stop")).status_code == 200

    run(scenario())


def test_reported_activity_keeps_a_session_from_becoming_idle(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client = await harness.log_in("operator")
        for _ in range(5):
            harness.clock.now += SESSION_IDLE_TIMEOUT_S - 1
            assert (await client.post("/api/v1/session/activity")).json()["idle"] is False
        answer = await client.post("/api/v1/drives/fan-1/run", json={"frequency_hz": 5.0})
        assert answer.status_code == 200

    run(scenario())


def test_a_stop_is_executed_while_the_audit_trail_cannot_be_written(tmp_path: Path) -> None:
    """Administration waits for the trail; login, reads and stops do not."""
    harness = WebAppHarness(tmp_path)
    harness.service.audit_fails = True

    async def scenario() -> None:
        client = await harness.log_in("administrator")
        assert (await client.post("/api/v1/stop")).status_code == 200
        before = harness.auth.database
        body = {"name": "eve", "role": "viewer", "password": PASSWORD}
        refused = await client.post("/api/v1/users", json=body)
        assert (refused.status_code, refused.json()["error"]["code"]) == (503, "auth.no_record")
        assert (await client.patch("/api/v1/users/viewer", json={"role": "engineer"})).status_code == 503
        assert (await client.post("/api/v1/tokens", json={"name": "t", "rights": ["view"]})).status_code == 503
        assert harness.auth.database == before
        assert (await client.post("/api/v1/logout")).status_code == 200

    run(scenario())


def test_a_login_code_works_once(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        code = await harness.auth.issue_code("operator", 3600)
        client = harness.client()
        assert (await client.get(f"/api/v1/login/code?code={code}")).status_code == 405
        assert (await client.post("/api/v1/login/code", json={"code": code})).json()["user"] == "operator"
        assert (await harness.client().post("/api/v1/login/code", json={"code": code})).status_code == 401

    run(scenario())


def test_users_and_tokens_are_added_shown_changed_and_recorded(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        admin = await harness.log_in("administrator")
        body = {"name": "王伟", "role": "operator", "password": PASSWORD}
        made = (await admin.post("/api/v1/users", json=body)).json()["user"]
        assert made == {
            "name": "王伟",
            "role": "operator",
            "disabled": False,
            "created_ms": harness.clock.wall_ms(),
            "sessions": 0,
            "tokens": 0,
        }
        assert (await admin.post("/api/v1/users", json=body)).status_code == 409
        assert (await admin.patch("/api/v1/users/王伟", json={"password": "short"})).status_code == 422
        new = {"password": "another pass phrase", "role": "engineer"}
        assert (await admin.patch("/api/v1/users/王伟", json=new)).json()["user"]["role"] == "engineer"
        wang = harness.client()
        assert (await wang.post("/api/v1/login", json={"name": "王伟", "password": new["password"]})).status_code == 200
        listed = (await admin.get("/api/v1/users")).json()["users"]
        assert [user["sessions"] for user in listed if user["name"] == "王伟"] == [1]
        assert "argon2" not in (await admin.get("/api/v1/users")).text
        assert (await admin.delete("/api/v1/users/王伟")).status_code == 200
        assert (await wang.get("/api/v1/drives")).status_code == 401
        assert (await admin.delete("/api/v1/users/王伟")).status_code == 404
        message = [
            (entry["what"], entry["outcome"]) for entry, _ in harness.service.records if "user." in entry["what"]
        ]
        assert message[:4] == [
            ("user.add", "requested"),
            ("user.add", "done"),
            ("user.add", "requested"),
            ("user.add", "auth.name_taken"),
        ]
        assert PASSWORD not in repr(harness.service.records) and "another pass" not in repr(harness.service.records)

    run(scenario())


def test_a_user_changes_the_own_password(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client, elsewhere = await harness.log_in("viewer"), await harness.log_in("viewer")
        wrong = await client.post("/api/v1/password", json={"old": "wrong", "new": "another pass phrase"})
        assert wrong.status_code == 403, "401 would mean that the session is over"
        done = await client.post("/api/v1/password", json={"old": PASSWORD, "new": "another pass phrase"})
        assert done.status_code == 200 and done.json()["user"] == "viewer"
        assert (await client.get("/api/v1/drives")).status_code == 200
        assert (await elsewhere.get("/api/v1/drives")).status_code == 401

    run(scenario())
