"""The API: every operation has its route, parameters arrive strictly as they were sent, errors have one shape."""

from __future__ import annotations

import json
import threading
import time
from typing import Any

import pytest

from drivebus.errors import DrivebusError, LimitError, OutcomeUnknown, ServiceUnavailable
from drivebus.service.api.operations import API_PREFIX, OPERATIONS, Operation
from drivebus.service.auth import errors as auth_errors
from drivebus.service.auth.actor import Actor
from drivebus.service.auth.rights import ROLE_RIGHTS, Role
from drivebus.service.ipc.service_client import ServiceErrorReply
from drivebus.web.api.openapi import STATUS_MEANINGS
from drivebus.web.errors import BUS_FAILURE_STATUS, HTTP_STATUS, error_headers, http_status
from fixtures.rest_api import OPERATOR, FakeService, app_of, client_of

VIEWER = Actor("wang", ROLE_RIGHTS[Role.VIEWER], "s-wang")
ENGINEER = Actor("zhao", ROLE_RIGHTS[Role.ENGINEER], "s-zhao")
RUN = f"{API_PREFIX}/drives/fan-1/run"


def address(operation: Operation) -> str:
    return API_PREFIX + operation.path.format(**operation.example)


async def ask(service: FakeService, method: str, path: str, actor: Actor = OPERATOR, **rest: Any) -> Any:
    async with client_of(app_of(service, actor)) as client:
        return await client.request(method, path, **rest)


@pytest.mark.parametrize("operation", OPERATIONS.values(), ids=lambda operation: operation.name)
async def test_the_example_of_an_operation_reaches_the_service_unchanged(operation: Operation) -> None:
    service = FakeService(**{"history.export": {"file": "x.csv", "text": ""}})
    rest = {name: value for name, value in operation.example.items() if name not in operation.path_params}
    given: Any = {"json": rest} if operation.has_body else {"params": rest}
    answer = await ask(service, operation.method, address(operation), ENGINEER, **given)
    assert answer.status_code == 200, answer.text
    assert service.calls == [(operation.name, operation.example, ENGINEER)]


MALFORMED = [
    '{"frequency_hz": NaN}',
    '{"frequency_hz": Infinity}',
    '{"frequency_hz": 1e999}',
    '{"frequency_hz": 1' + "0" * 5000 + "}",
    '{"frequency_hz": 25.0, "frequency_hz": 50.0}',
    "{",
    "[" * 100_000,
    "\xff",
]


@pytest.mark.parametrize("body", MALFORMED, ids=lambda body: body[:40])
async def test_a_body_without_one_meaning_is_rejected_before_any_parameter_is_read(body: str) -> None:
    service = FakeService()
    answer = await ask(service, "POST", RUN, content=body.encode("latin-1"))
    assert (answer.status_code, answer.json()["error"]["kind"], service.calls) == (422, "MalformedBody", [])


@pytest.mark.parametrize(
    "body",
    [
        '{"frequency_hz": "25.0"}',
        '{"frequency_hz": true}',
        '{"frequency_hz": null}',
        '{"frequency_hz": [25.0]}',
        '{"frequency_hz": 1' + "0" * 400 + "}",
        '{"frequency_hz": 25.0, "maximum_hz": 400.0}',
        '{"frequency_hz": 25.0, "drive": "fan-2"}',
        '{"frequency_hz": 25.0, "arm_token": "\\ud800"}',
        '{"frequency_hz": 25.0, "direction": 1}',
        "[25.0]",
        "25.0",
        "",
    ],
    ids=lambda body: body[:40],
)
async def test_a_start_with_a_wrong_parameter_is_rejected_and_not_executed(body: str) -> None:
    plant = FakeService()
    answer = await ask(plant, "POST", RUN, content=body.encode("latin-1"), headers={"Content-Type": "application/json"})
    error = answer.json()["error"]
    assert (answer.status_code, error["kind"], error["code"]) == (422, "InvalidParameters", "plant.params")
    assert error["params"]["faults"] and plant.calls == []
    assert plant.records == [], "only the service and the middleware write the audit trail"


@pytest.mark.parametrize("number", ["NaN", "-Infinity", "1e999", "9" * 5_000])
async def test_a_number_beyond_a_double_is_rejected_also_under_an_unknown_name(number: str) -> None:
    """RFC 8259, section 6: NaN and Infinity are not JSON, and a number beyond a double has no portable meaning."""
    answer = await ask(FakeService(), "POST", RUN, content=f'{{"anything": {number}}}'.encode())
    assert answer.status_code == 422
    assert answer.json()["error"]["params"] == {"problem": number[:40]}


async def test_a_whole_number_may_be_written_with_a_point() -> None:
    """JSON has one kind of number; regression, found by schemathesis: 60.0 minutes were rejected."""
    plant, path = FakeService(), f"{API_PREFIX}/alarms/a/shelve"
    answers = [
        await ask(plant, "POST", path, content=f'{{"minutes": {minutes}, "reason": "work"}}'.encode())
        for minutes in ("60.0", "60.5", '"60"', "true")
    ]
    assert [answer.status_code for answer in answers] == [200, 422, 422, 422]
    assert type(plant.calls[0][1]["minutes"]) is int


@pytest.mark.parametrize(
    "query", ["after=1.0", "after=１", "after=+1", "after=1_0", "after=", "after=1&after=2", "x=1"]
)
async def test_a_query_is_as_strict_as_a_body(query: str) -> None:
    plant = FakeService()
    answer = await ask(plant, "GET", f"{API_PREFIX}/buses/line-1/frames?{query}")
    assert (answer.status_code, plant.calls) == (422, [])


MANY = [f"n{number}" for number in range(60_000)]


@pytest.mark.parametrize(
    ("method", "path", "body", "faults"),
    [
        ("POST", "/stop", dict.fromkeys(MANY, 0), 100),
        ("POST", "/drives/fan-1/parameters/write", {"values": dict.fromkeys(MANY, "")}, 1),
        ("POST", "/alarms/acknowledge", {"alarms": [*range(1000)]}, 100),
        ("GET", "/plant?" + "&".join(f"{number}=" for number in range(9_000)), None, 100),
    ],
    ids=["names", "values", "list", "query"],
)
async def test_a_request_with_thousands_of_wrong_parameters_never_occupies_the_process(
    method: str, path: str, body: Any, faults: int
) -> None:
    """A body of 900 kB, sent with the right to stop, kept the process busy for ten seconds, and delayed stops."""
    started = time.process_time()
    answer = await ask(FakeService(), method, API_PREFIX + path, **({} if body is None else {"json": body}))
    assert time.process_time() - started < 4.0
    assert (answer.status_code, len(answer.json()["error"]["params"]["faults"])) == (422, faults)


async def test_a_command_rejects_a_query() -> None:
    plant = FakeService()
    answer = await ask(plant, "POST", f"{RUN}?frequency_hz=50", json={"frequency_hz": 25.0})
    assert (answer.status_code, plant.calls) == (422, [])


async def test_one_tag_in_a_query_is_a_list_of_one() -> None:
    plant = FakeService()
    await ask(plant, "GET", f"{API_PREFIX}/history/trend?tags=a&from_ms=0&to_ms=9")
    assert plant.calls[0][1] == {"tags": ["a"], "from_ms": 0, "to_ms": 9}


async def test_an_operation_without_its_right_is_denied() -> None:
    plant = FakeService()
    answer = await ask(plant, "POST", f"{API_PREFIX}/drives/fan-1/stop", VIEWER)
    assert (answer.status_code, answer.json()["error"]["kind"], plant.calls) == (403, "PermissionDenied", [])


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (LimitError("drives.above_maximum", asked=60.0, maximum=50.0), 422),
        (OutcomeUnknown("drives.unknown_sent"), 504),
        (ServiceUnavailable("plant.gone"), 503),
    ],
    ids=lambda value: str(value)[:12],
)
async def test_an_error_of_the_drive_has_its_status_and_both_languages(error: Any, status: int) -> None:
    answer = await ask(FakeService(**{"drive.run": error}), "POST", RUN, json={"frequency_hz": 60.0})
    message = answer.json()["error"]
    assert (answer.status_code, message["code"]) == (status, error.key)
    assert message["text"] == {"en": error.text("en"), "zh": error.text("zh")}


async def test_an_unexpected_error_shows_nothing_of_the_inside() -> None:
    def broken(_: Any) -> Any:
        raise RuntimeError("/secret/path")

    answer = await ask(FakeService(**{"drives.list": broken}), "GET", f"{API_PREFIX}/drives")
    assert (answer.status_code, answer.json()["error"]["code"]) == (500, "api.unforeseen")
    assert "secret" not in answer.text


@pytest.mark.parametrize(("method", "path", "status"), [("GET", "/nowhere", 404), ("PATCH", "/drives/fan-1/run", 405)])
async def test_errors_of_the_framework_have_the_same_shape(method: str, path: str, status: int) -> None:
    answer = await ask(FakeService(), method, API_PREFIX + path)
    assert (answer.status_code, answer.json()["error"]["kind"]) == (status, "HttpError")


async def test_an_export_of_many_parts_is_one_file() -> None:
    parts = {None: {"file": "a.csv", "text": "t;v\n", "next": "1"}, "1": {"file": "a.csv", "text": "1;2\n"}}
    plant = FakeService(**{"history.export": lambda params: parts[params.get("cursor")]})
    answer = await ask(plant, "GET", f"{API_PREFIX}/history/export?tags=a&from_ms=0&to_ms=9")
    assert (answer.text, answer.headers["content-type"]) == ("t;v\n1;2\n", "text/csv; charset=utf-8")
    assert answer.headers["content-disposition"] == 'attachment; filename="a.csv"'


def test_every_status_that_an_error_may_have_is_described() -> None:
    assert {status for _, status in HTTP_STATUS} | {BUS_FAILURE_STATUS, 500} == STATUS_MEANINGS.keys()


async def test_an_error_of_the_service_is_forwarded_as_it_was_sent() -> None:
    payload = b'{"kind":"ControlNotHeld","code":"x.y","text":{"en":"a","zh":"b"},"unknown":[1.50]}'

    def fail(_: Any) -> Any:
        raise ServiceErrorReply(payload)

    answer = await ask(FakeService(**{"drives.list": fail}), "GET", f"{API_PREFIX}/drives")
    assert (answer.status_code, answer.content) == (409, b'{"error":' + payload + b"}")


@pytest.mark.parametrize(
    ("kind", "status"), [("NotFound", 404), ("NoReply", 502), ("Unheard", 409), ("annotations", 409)]
)
async def test_the_status_of_a_forwarded_error_is_that_of_its_class(kind: str, status: int) -> None:
    def fail(_: Any) -> Any:
        raise ServiceErrorReply(json.dumps({"kind": kind}).encode())

    assert (await ask(FakeService(**{"drives.list": fail}), "GET", f"{API_PREFIX}/drives")).status_code == status


async def test_a_service_that_refuses_further_commands_says_when_to_try_again() -> None:
    def fail(_: Any) -> Any:
        raise ServiceErrorReply(json.dumps({"kind": "TooManyCommands", "params": {"retry_s": 1.2}}).encode())

    answer = await ask(FakeService(**{"drives.list": fail}), "GET", f"{API_PREFIX}/drives")
    assert (answer.status_code, answer.headers["retry-after"]) == (429, "2")


async def test_the_description_is_made_beside_other_requests(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first one takes a second, in which the event loop would answer no stop."""
    app, threads = app_of(FakeService()), list[threading.Thread]()
    monkeypatch.setattr(app, "openapi", lambda: threads.append(threading.current_thread()) or {})
    async with client_of(app) as client:
        assert (await client.get(f"{API_PREFIX}/openapi.json")).json() == {}
    assert [thread is threading.main_thread() for thread in threads] == [False]


async def test_the_description_names_every_route_with_errors_and_who_may() -> None:
    answer = await ask(FakeService(), "GET", f"{API_PREFIX}/openapi.json")
    paths = answer.json()["paths"]
    for route in OPERATIONS.values():
        message = paths[API_PREFIX + route.path][route.method.lower()]
        assert str(route.right) in message["description"]
        assert {"200", "401", "403", "422", "503"} <= message["responses"].keys()
        assert {"token": []} in message["security"]
        assert [parameter["name"] for parameter in message["parameters"] if parameter["in"] == "path"] == list(
            route.path_params
        )
    assert json.dumps(paths).count("HTTPValidationError") == 0


@pytest.mark.parametrize(
    ("kind", "status"),
    [
        (auth_errors.AuthError, 403),
        (auth_errors.NotAuthenticated, 401),
        (auth_errors.AccessDenied, 403),
        (auth_errors.Conflict, 409),
        (auth_errors.ResourceNotFound, 404),
        (auth_errors.InvalidInput, 422),
        (auth_errors.TooManyAttempts, 429),
        (auth_errors.AuthUnavailable, 503),
    ],
)
def test_each_authentication_error_has_its_status(kind: type[DrivebusError], status: int) -> None:
    assert http_status(kind) == status


def test_retry_after_is_never_shorter_than_the_delay() -> None:
    errors = [auth_errors.TooManyAttempts("auth.too_many", retry_s=retry_s) for retry_s in (0.1, 1.9, 2.0)]
    assert [error_headers(error) for error in errors] == [{"Retry-After": value} for value in ("1", "2", "3")]
    assert error_headers(auth_errors.AccessDenied("auth.csrf")) == {}
