"""Limits of a request: size, time, depth, one meaning; and texts that contain control characters or markup."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import httpx
import pytest
from starlette.datastructures import Headers

from drivebus.service.api.strict_json import parse_json
from drivebus.testing.virtual_time import run
from drivebus.web.errors import RequestError, http_status
from drivebus.web.middleware.request_body import (
    BODY_TIMEOUT_S,
    MAX_BODY_BYTES,
    MAX_PUBLIC_BODY_BYTES,
    read_body,
)
from drivebus.web.middleware.security_headers import CSP
from fixtures.web_app import WebAppHarness

RUN = "/api/v1/drives/fan-1/run"
JSON = {"content-type": "application/json"}


@pytest.mark.parametrize(
    ("body", "status"),
    [
        (b'{"frequency_hz": 5.0, "frequency_hz": 50.0}', 422),
        (b'{"frequency_hz": 5.0, "x": {"a": 1, "a": 2}}', 422),
        (b'{"frequency_hz": NaN}', 422),
        (b'{"frequency_hz": Infinity}', 422),
        (b'{"frequency_hz": 5.0} {}', 422),
        (b'{"frequency_hz": 5.0', 422),
        (b'\xff\xfe{"frequency_hz": 5.0}', 422),
        (b'{"frequency_hz": "\xed\xa0\x80"}', 422),
        (b"[" * 500_000, 422),
        (b'{"a":' * 150_000, 422),
        (b'{"frequency_hz": ' + b"9" * 100_000 + b"}", 422),
        (b"x" * (MAX_BODY_BYTES + 1), 413),
    ],
    ids=range(12),
)
def test_an_ambiguous_body_is_rejected(body: bytes, status: int, tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client = await harness.log_in("operator")
        answer = await client.post(RUN, content=body, headers=JSON)
        assert answer.status_code == status, answer.text[:300]
        assert answer.json()["error"]["text"].keys() == {"en", "zh"}
        assert harness.service.calls == []

    run(scenario())


@pytest.mark.parametrize(
    ("body", "code"),
    [
        (b'{"name": "operator", "name": "viewer", "password": "x"}', "auth.twice"),
        (b'{"name": "viewer", "password": "x", "more": [{"a": 1, "b": 2, "a": 3}]}', "auth.twice"),
        (b'{"\\ud800": 1, "\\ud800": 2}', "auth.twice"),  # it was an internal error, with 50 lines in the log
        (b'{"name": "viewer", "password": NaN}', "auth.malformed"),
        (b'{"name": "viewer"', "auth.malformed"),
        (b"[" * 4000, "auth.malformed"),
    ],
    ids=range(6),
)
def test_a_public_body_with_two_meanings_is_rejected_before_its_route(body: bytes, code: str, tmp_path: Path) -> None:
    """No library behind the middleware takes the last of two values, or a part of the body."""
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        answer = await harness.client().post("/api/v1/login", content=body, headers=JSON)
        assert (answer.status_code, answer.json()["error"]["code"]) == (422, code), answer.text
        if code == "auth.twice":
            assert answer.json()["error"]["params"]["names"] in (["name"], ["a"], ["\ud800"])

    run(scenario())


def test_the_response_to_many_repeated_names_is_short(tmp_path: Path) -> None:
    """It named all of them: 2 MB for a body of 1 MB, made while a stop over the page waited."""
    harness = WebAppHarness(tmp_path)
    members = ",".join(f'"{number // 2:050}":0' for number in range(16_000))

    async def scenario() -> None:
        client = await harness.log_in("operator")
        answer = await client.post(RUN, content=f"{{{members}}}", headers=JSON)
        assert answer.status_code == 422 and len(answer.content) < 3_000
        assert len(answer.json()["error"]["params"]["names"]) == 10

    run(scenario())


def test_the_size_limits_are_those_that_were_measured() -> None:
    assert (MAX_BODY_BYTES, MAX_PUBLIC_BODY_BYTES, BODY_TIMEOUT_S) == (1024 * 1024, 4096, 10.0)


def coming(*parts: bytes) -> Any:
    """Return an ASGI ``receive`` of a body in parts, followed by the end of the connection."""
    messages = [{"type": "http.request", "body": part, "more_body": part is not parts[-1]} for part in parts]
    waiting = iter([*messages, {"type": "http.disconnect"}])

    async def receive() -> Any:
        return next(waiting)

    return receive


@pytest.mark.parametrize("length", [b"\xb2", b"\xb9\xb9", b"+1", b"-1", b"1_0", b" 1", b"0x1", b"", b"9" * 5000])
def test_an_invalid_content_length_is_rejected(length: bytes) -> None:
    headers = Headers(raw=[(b"content-length", length)])
    with pytest.raises(RequestError) as refused:
        run(read_body(coming(b""), headers))
    assert (refused.value.key, http_status(type(refused.value))) == ("auth.too_large", 413)
    assert refused.value.params == {"largest": 1024 * 1024}


@pytest.mark.parametrize("length", [b"3", None])
def test_the_size_of_a_body_is_counted_and_not_taken_from_its_header(length: bytes | None) -> None:
    kind = (b"content-type", b"application/json")
    headers = Headers(raw=[kind] if length is None else [kind, (b"content-length", length)])
    assert run(read_body(coming(b"[1", b"]"), headers, 3)) == [1]
    with pytest.raises(RequestError) as refused:
        run(read_body(coming(b"[1", b"]", b" "), headers, 3))
    assert (refused.value.key, refused.value.params) == ("auth.too_large", {"largest": 3})


def test_a_message_without_more_body_is_the_last() -> None:
    """``more_body`` is false by default in ASGI."""

    async def whole() -> Any:
        return {"type": "http.request", "body": b"{}"}

    assert run(read_body(whole, Headers({"content-type": "application/json"}), 3)) == {}


def test_an_incomplete_body_is_rejected() -> None:
    async def gone() -> Any:
        return {"type": "http.disconnect"}

    with pytest.raises(RequestError) as refused:
        run(read_body(gone, Headers()))
    assert (refused.value.key, refused.value.params) == ("auth.malformed", {"problem": "disconnected"})


def test_a_body_has_ten_seconds() -> None:
    async def never() -> Any:
        await asyncio.sleep(3600)

    async def scenario() -> float:
        begun = asyncio.get_running_loop().time()
        with pytest.raises(RequestError) as refused:
            await read_body(never, Headers())
        assert (refused.value.key, refused.value.params) == ("auth.too_slow", {"longest_s": 10.0})
        return asyncio.get_running_loop().time() - begun

    assert run(scenario()) == 10.0


@pytest.mark.parametrize(
    ("kind", "more", "fits"),
    [
        ("application/json", {}, True),
        ("Application/JSON ; Charset=UTF-8", {}, True),
        ("application/json", {"content-encoding": "identity"}, True),
        ("application/json", {"content-encoding": "br"}, False),
        ("application/json; charset=gbk", {}, False),
        ("application/json; boundary=x", {}, False),
        ("text/plain", {}, False),
        (None, {}, False),
    ],
)
def test_only_json_in_utf_8_is_read(kind: str | None, more: dict[str, str], fits: bool) -> None:
    headers = Headers(({} if kind is None else {"content-type": kind}) | more)
    if fits:
        assert run(read_body(coming(b"{}"), headers)) == {}
        return
    with pytest.raises(RequestError) as refused:
        run(read_body(coming(b"{}"), headers))
    assert (refused.value.key, http_status(type(refused.value))) == ("auth.not_json", 415)
    assert refused.value.params == {"found": kind or ""}


def test_a_missing_body_is_an_empty_object() -> None:
    assert run(read_body(coming(b""), Headers())) == {}


@pytest.mark.parametrize(("text", "value"), [(b"60.0", 60), (b"60.5", 60.5), (b"-0.0", 0), (b"1e300", 1e300)])
def test_a_whole_number_is_an_integer_in_any_notation(text: bytes, value: float) -> None:
    found = parse_json(text)
    assert (found, type(found)) == (value, type(value))


async def test_a_rejected_body_never_reaches_the_process_of_the_buses(tmp_path: Path) -> None:
    """Parsing a mebibyte of numbers takes 0.2 s, which would delay every bus."""
    harness = WebAppHarness(tmp_path)
    client = await harness.log_in("engineer")
    body = b'{"values": {"F0.1": [' + b",".join([b"1.5"] * 250_000) + b"]}}"
    for content in (body, b'{"values": {"F0.1": true}}', b'{"values": {}, "unknown": 1}'):
        answer = await client.post("/api/v1/drives/fan-1/parameters/write", content=content, headers=JSON)
        assert (answer.status_code, answer.json()["error"]["code"]) == (422, "plant.params")
    assert (await client.get("/api/v1/history/export?tags=a&from_ms=-1&to_ms=9")).status_code == 422
    assert harness.service.calls == []


def test_a_body_of_one_mebibyte_is_accepted(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client = await harness.log_in("engineer")
        body = json.dumps({"text": ""}).encode()
        for more in ({}, {"content-length": str(MAX_BODY_BYTES)}):
            whole = body + b" " * (MAX_BODY_BYTES - len(body))
            answer = await client.post("/api/v1/configuration/check", content=whole, headers={**JSON, **more})
            assert answer.status_code == 200, answer.text

    run(scenario())


def test_public_routes_accept_only_small_bodies(tmp_path: Path) -> None:
    """Parsing a mebibyte of braces takes the web process 0.3 s, which would delay a stop."""
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client = harness.client()
        body = json.dumps({"name": "unknown", "password": "x"}).encode()
        fits = await client.post("/api/v1/login", content=body.ljust(MAX_PUBLIC_BODY_BYTES), headers=JSON)
        assert fits.status_code == 401, fits.text
        too_much = await client.post("/api/v1/login", content=body.ljust(MAX_PUBLIC_BODY_BYTES + 1), headers=JSON)
        assert too_much.status_code == 413, too_much.text
        assert too_much.json()["error"]["params"]["largest"] == MAX_PUBLIC_BODY_BYTES
        viewer = await harness.log_in("viewer")
        too_much = await viewer.post("/api/v1/tokens", content=b"{}".ljust(MAX_PUBLIC_BODY_BYTES + 1), headers=JSON)
        assert too_much.status_code == 413, too_much.text

    run(scenario())


async def status_of(harness: WebAppHarness, headers: dict[str, str], parts: Any) -> int:
    """Return the status of a request whose body comes in ``parts``: (bytes, seconds before them)."""
    statuses: list[int] = []

    async def receive() -> Any:
        for part, pause_s in parts:
            await asyncio.sleep(pause_s)
            return {"type": "http.request", "body": part, "more_body": True}
        return {"type": "http.request", "body": b"", "more_body": False}

    async def send(message: Any) -> None:
        statuses.extend([message["status"]] if message["type"] == "http.response.start" else [])

    scope = {
        "type": "http",
        "asgi": {"version": "3.0"},
        "http_version": "1.1",
        "method": "POST",
        "scheme": "http",
        "path": RUN,
        "raw_path": RUN.encode(),
        "query_string": b"",
        "root_path": "",
        "headers": [(name.lower().encode(), value.encode()) for name, value in headers.items()],
        "client": ("127.0.0.1", 5),
        "server": ("127.0.0.1", 8080),
    }
    await harness.app(scope, receive, send)
    return statuses[0]


@pytest.mark.parametrize(
    ("more", "parts", "status"),
    [
        ({"content-length": str(100 * MAX_BODY_BYTES)}, iter([]), 413),
        ({"content-length": "-1"}, iter([]), 413),
        ({"content-length": "٣"}, iter([]), 413),
        ({}, ((b"x" * 65536, 0.0) for _ in range(10_000)), 413),
        ({}, ((b" ", 1.0) for _ in range(10_000)), 408),
        ({}, iter([(b"{", BODY_TIMEOUT_S + 1)]), 408),
    ],
    ids=["declared", "negative", "another digit", "undeclared", "a drip", "silence"],
)
def test_a_hundred_megabytes_and_a_slow_drip_end_early(
    more: dict[str, str], parts: Any, status: int, tmp_path: Path
) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        token = await harness.token("operator", "operate", "stop")
        headers = {"host": "127.0.0.1:8080", "authorization": f"Bearer {token}", **JSON} | more
        begun = asyncio.get_running_loop().time()
        assert await status_of(harness, headers, parts) == status
        assert asyncio.get_running_loop().time() - begun <= BODY_TIMEOUT_S
        assert harness.service.calls == []

    run(scenario())


def test_the_body_of_an_unauthenticated_request_is_not_read(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        def never() -> Any:
            raise AssertionError("read")
            yield

        assert await status_of(harness, {"host": "127.0.0.1:8080", **JSON}, never()) == 401

    run(scenario())


HOSTILE = 'x"\r\n{"what":"login","outcome":"done"}\x1b[2J\u202e<script>alert(1)</script>=cmd|\'/c calc\'!A0'


def test_no_text_of_a_client_adds_a_line_to_the_audit_trail(tmp_path: Path) -> None:
    """Hostile names, passwords, headers and addresses stay one JSON string each."""
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client = harness.client()
        body = {"name": HOSTILE[:60], "password": HOSTILE}
        assert (await client.post("/api/v1/login", json=body)).status_code == 401
        assert (await client.get("/api/v1/%0d%0aSet-Cookie:x=1%1b[2J")).status_code == 404
        assert (
            await client.get("/api/v1/drives", headers={"user-agent": "\x1b[2J", "cookie": '"\\012'})
        ).status_code == 401
        assert harness.service.records
        for entry, actor in harness.service.records:
            line = json.dumps([entry, actor.as_json()])
            assert "\n" not in line and "\r" not in line and "\x1b" not in line
            assert json.loads(line)[0]["what"] == "refused"

    run(scenario())


@pytest.mark.parametrize(
    "path", ["/api/v1/%0d%0aSet-Cookie:x=1", "/static/%3Cscript%3E", "/i18n/<b>.json", "/api/v1/drives/<b>"]
)
def test_an_error_about_an_address_is_not_html(path: str, tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client = await harness.log_in("viewer")
        answer = await client.get(path)
        assert answer.headers["content-type"].startswith("application/json")
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert "x=1" not in answer.headers.get("set-cookie", "")

    run(scenario())


@pytest.mark.parametrize(
    "path",
    [
        "/static/../__main__.py",
        "/static/%2e%2e/__main__.py",
        "/static/..%2f__main__.py",
        "/static//etc/passwd",
        "/static/%2fetc%2fpasswd",
        "/vendor/../../cli/root.py",
        "/static/",
        "/static",
        "/static/js",
        "/static/\x00",
        "/static/" + "a" * 5000,
        "/vendor/%00",
        "/i18n/../x.json",
        "/i18n/fr.json",
        "/static/none.js",
    ],
)
def test_only_files_of_the_page_are_served(path: str, tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        from httpx import InvalidURL

        try:
            answer = await harness.client().get(path)
        except InvalidURL:
            return
        assert answer.status_code in (403, 404), path

    run(scenario())


@pytest.mark.parametrize(
    "path", ["/", "/static/js/app.js", "/i18n/en.json", "/i18n/zh.json", "/api/v1/session", "/nothing"]
)
def test_every_response_has_the_security_headers(path: str, tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        answer = await harness.client().get(path)
        assert answer.headers["content-security-policy"] == CSP
        assert "unsafe" not in CSP and "*" not in CSP and CSP.startswith("default-src 'none'")
        for name, value in {
            "x-content-type-options": "nosniff",
            "x-frame-options": "DENY",
            "referrer-policy": "no-referrer",
            "cross-origin-opener-policy": "same-origin",
            "cross-origin-resource-policy": "same-origin",
            "cache-control": "no-store" if path.startswith("/api/") else "no-cache",
        }.items():
            assert answer.headers.get_list(name) == [value], name
        kind = {"/": "text/html", "/static/js/app.js": "text/javascript"}.get(path, "application/json")
        assert answer.headers["content-type"].partition(";")[0] == kind
        assert kind == "application/json" or "charset=utf-8" in answer.headers["content-type"]
        assert "server" not in answer.headers

    run(scenario())


def test_a_file_is_compressed_and_cached(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client = harness.client()
        first = await client.get("/i18n/en.json", headers={"accept-encoding": "gzip"})
        assert first.headers["content-encoding"] == "gzip" and first.json()["auth.not_logged_in"]
        plain = await client.get("/i18n/en.json", headers={"accept-encoding": "identity"})
        assert "content-encoding" not in plain.headers and plain.content == first.content
        again = await client.get("/i18n/en.json", headers={"if-none-match": first.headers["etag"]})
        assert (again.status_code, again.content) == (304, b"")

    run(scenario())


def test_an_unexpected_error_shows_no_internals(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def failing(*_: Any) -> Any:
        raise RuntimeError("/secret/path")

    harness.service.call = failing  # type: ignore[method-assign]

    async def scenario() -> None:
        client = await harness.log_in("operator")
        answer = await client.post("/api/v1/stop")
        assert answer.status_code == 500 and "secret" not in answer.text
        assert answer.headers["content-security-policy"] == CSP

    try:
        run(scenario())
    finally:
        del harness.service.call


COMMANDS: list[tuple[str, Any]] = [("run", {"frequency_hz": 5.0}), ("stop", {})]


def test_a_stop_overtakes_reads_that_were_sent_before_it(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client = await harness.log_in("operator")
        harness.service.calls.clear()
        questions = [client.get("/api/v1/buses") for _ in range(20)]
        run, stop = (client.post(f"/api/v1/drives/fan-1/{what}", json=body) for what, body in COMMANDS)
        answers = await asyncio.gather(*questions, run, stop)
        assert {answer.status_code for answer in answers} == {200}
        calls = [call[0] for call in harness.service.calls]
        assert len(calls) == 22 and calls.index("drive.stop") < 10, calls
        assert calls.index("drive.run") < calls.index(
            "drive.stop"
        )  # a start never executes after the stop that followed it

    run(scenario())


def test_a_stop_overtakes_the_denials_of_unauthenticated_requests(tmp_path: Path) -> None:
    """Unauthenticated stops and starts do not delay a user's stop."""
    harness = WebAppHarness(tmp_path)

    async def scenario() -> None:
        client, anonymous, statuses = await harness.log_in("operator"), harness.client(), list[int]()

        async def send(sender: httpx.AsyncClient, command: str) -> None:
            statuses.append((await sender.post(f"/api/v1/drives/fan-1/{command}", json={})).status_code)

        flood = [send(anonymous, command) for command in ("stop", "run") * 10]
        await asyncio.gather(*flood, send(client, "stop"))
        assert len(statuses) == 21 and statuses.index(200) < 10, statuses

    run(scenario())
