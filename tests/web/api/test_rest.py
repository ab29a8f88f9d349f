"""REST: every operation has its address, what is asked arrives strictly as it was asked, errors have one shape."""

from __future__ import annotations

import json
from typing import Any

import pytest

from drivebus.errors import DrivebusError, LimitError, OutcomeUnknown, ServiceUnavailable
from drivebus.service.api.examples import PARAM_EXAMPLES
from drivebus.service.api.operations import OPERATIONS
from drivebus.service.auth.actor import Actor
from drivebus.service.auth.rights import ROLE_RIGHTS, Role
from drivebus.web.api.descriptions import STATUS_MEANINGS
from drivebus.web.api.table import API_PREFIX, API_ROUTES, ApiRoute
from drivebus.web.error_status import STATUS_BY_ERROR, RequestError
from fixtures.rest_api import OPERATOR, FakeService, app_of, client_of

VIEWER = Actor("wang", ROLE_RIGHTS[Role.VIEWER], "s-wang")
ENGINEER = Actor("zhao", ROLE_RIGHTS[Role.ENGINEER], "s-zhao")
RUN = f"{API_PREFIX}/drives/fan-1/run"


def address(route: ApiRoute) -> str:
    return API_PREFIX + route.path.format(**PARAM_EXAMPLES)


def example(route: ApiRoute) -> dict[str, Any]:
    return {name: PARAM_EXAMPLES[name] for name in route.param_schemas() if name in PARAM_EXAMPLES}


async def ask(plant: FakeService, method: str, path: str, actor: Actor = OPERATOR, **rest: Any) -> Any:
    async with client_of(app_of(plant, actor)) as client:
        return await client.request(method, path, **rest)


def test_s02_every_operation_has_exactly_one_address() -> None:
    assert sorted(route.name for route in API_ROUTES) == sorted(OPERATIONS)
    assert len({(route.method, route.path) for route in API_ROUTES}) == len(API_ROUTES)


def test_s03_nothing_that_changes_anything_is_reached_by_get() -> None:
    assert [route for route in API_ROUTES if route.method == "GET" and route.operation.mutates] == []


@pytest.mark.parametrize("route", API_ROUTES, ids=lambda route: route.name)
async def test_the_example_of_every_route_reaches_its_operation_as_it_was_written(route: ApiRoute) -> None:
    plant = FakeService(**{"history.export": {"file": "x.csv", "text": ""}})
    given = {"json": example(route)} if route.has_body else {"params": example(route)}
    answer = await ask(plant, route.method, address(route), ENGINEER, **given)
    assert answer.status_code == 200, answer.text
    wanted = example(route) | {name: PARAM_EXAMPLES[name] for name in route.path_params}
    assert plant.calls == [(route.name, wanted, ENGINEER)]


@pytest.mark.parametrize(
    "body",
    [
        '{"frequency_hz": "25.0"}',
        '{"frequency_hz": NaN}',
        '{"frequency_hz": Infinity}',
        '{"frequency_hz": 1e999}',
        '{"frequency_hz": true}',
        '{"frequency_hz": null}',
        '{"frequency_hz": [25.0]}',
        '{"frequency_hz": 1' + "0" * 400 + "}",
        '{"frequency_hz": 1' + "0" * 5000 + "}",
        '{"frequency_hz": 25.0, "frequency_hz": 50.0}',
        '{"frequency_hz": 25.0, "maximum_hz": 400.0}',
        '{"frequency_hz": 25.0, "drive": "fan-2"}',
        '{"frequency_hz": 25.0, "arm": "\\ud800"}',
        '{"frequency_hz": 25.0, "direction": 1}',
        "[25.0]",
        "25.0",
        "{",
        "[" * 100_000,
        "\xff",
        "",
    ],
    ids=lambda body: body[:40],
)
async def test_t19_s08_a_start_that_is_not_exactly_right_is_refused_and_reaches_nobody(body: str) -> None:
    plant = FakeService()
    answer = await ask(plant, "POST", RUN, content=body.encode("latin-1"), headers={"Content-Type": "application/json"})
    error = answer.json()["error"]
    assert (answer.status_code, error["kind"], error["code"]) == (422, "InvalidParameters", "plant.params")
    assert error["params"]["faults"] and plant.calls == []
    assert plant.records == [], "the plant and the door write the trail; this gateway never does"


@pytest.mark.parametrize("number", ["NaN", "-Infinity", "1e999"])
async def test_t19_what_is_no_number_is_refused_before_anybody_reads_it(number: str) -> None:
    """The plant's own models refuse it too; here even where no model looks."""
    answer = await ask(FakeService(), "POST", RUN, content=f'{{"anything": {number}}}'.encode())
    expected = {"en": "expected a finite number", "zh": "应为有限的数值"}
    assert answer.json()["error"]["params"]["faults"] == [{"path": "", "found": number, "expected": expected}]


async def test_a_whole_number_may_be_written_with_a_point() -> None:
    """JSON has one kind of number. Found by schemathesis: 60.0 minutes fit the description and were refused."""
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
async def test_t19_a_query_is_as_strict_as_a_body(query: str) -> None:
    plant = FakeService()
    answer = await ask(plant, "GET", f"{API_PREFIX}/buses/line-1/frames?{query}")
    assert (answer.status_code, plant.calls) == (422, [])


async def test_a_command_takes_nothing_from_its_query() -> None:
    plant = FakeService()
    answer = await ask(plant, "POST", f"{RUN}?frequency_hz=50", json={"frequency_hz": 25.0})
    assert (answer.status_code, plant.calls) == (422, [])


async def test_one_tag_is_a_list_of_one() -> None:
    plant = FakeService()
    await ask(plant, "GET", f"{API_PREFIX}/history/trend?tags=a&from_ms=0&to_ms=9")
    assert plant.calls[0][1] == {"tags": ["a"], "from_ms": 0, "to_ms": 9}


async def test_s08_who_lacks_the_right_is_told_so_and_nothing_is_done() -> None:
    plant = FakeService()
    answer = await ask(plant, "POST", f"{API_PREFIX}/drives/fan-1/stop", VIEWER)
    assert (answer.status_code, answer.json()["error"]["kind"], plant.calls) == (403, "Forbidden", [])


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
    told = answer.json()["error"]
    assert (answer.status_code, told["status"], told["code"]) == (status, status, error.key)
    assert told["text"] == {"en": error.text("en"), "zh": error.text("zh")}


async def test_what_nobody_foresaw_shows_nothing_of_the_inside() -> None:
    def broken(_: Any) -> Any:
        raise RuntimeError("/secret/path")

    answer = await ask(FakeService(**{"drives.list": broken}), "GET", f"{API_PREFIX}/drives")
    assert (answer.status_code, answer.json()["error"]["code"]) == (500, "api.unforeseen")
    assert "secret" not in answer.text


@pytest.mark.parametrize(("method", "path", "status"), [("GET", "/nowhere", 404), ("PATCH", "/drives/fan-1/run", 405)])
async def test_the_frameworks_own_errors_have_the_one_shape(method: str, path: str, status: int) -> None:
    answer = await ask(FakeService(), method, API_PREFIX + path)
    assert answer.json()["error"]["status"] == answer.status_code == status


async def test_an_export_of_many_parts_is_one_file() -> None:
    parts = {None: {"file": "a.csv", "text": "t;v\n", "next": "1"}, "1": {"file": "a.csv", "text": "1;2\n"}}
    plant = FakeService(**{"history.export": lambda params: parts[params.get("cursor")]})
    answer = await ask(plant, "GET", f"{API_PREFIX}/history/export?tags=a&from_ms=0&to_ms=9")
    assert (answer.text, answer.headers["content-type"]) == ("t;v\n1;2\n", "text/csv; charset=utf-8")
    assert answer.headers["content-disposition"] == 'attachment; filename="a.csv"'


def kinds(base: type[DrivebusError]) -> set[type[DrivebusError]]:
    return {base}.union(*map(kinds, base.__subclasses__()))


def test_every_status_that_an_error_may_have_is_described() -> None:
    import drivebus.web.app  # noqa: F401  the door's own errors are known once it is

    own = {kind.status for kind in kinds(RequestError) - {RequestError}}
    assert own | {status for _, status in STATUS_BY_ERROR} == STATUS_MEANINGS.keys()


async def test_the_description_names_every_route_with_errors_and_who_may() -> None:
    answer = await ask(FakeService(), "GET", f"{API_PREFIX}/openapi.json")
    paths = answer.json()["paths"]
    for route in API_ROUTES:
        told = paths[API_PREFIX + route.path][route.method.lower()]
        assert str(route.operation.right) in told["description"]
        assert {"200", "401", "403", "422", "503"} <= told["responses"].keys()
        assert {"token": []} in told["security"]
        assert [one["name"] for one in told["parameters"] if one["in"] == "path"] == list(route.path_params)
    assert json.dumps(paths).count("HTTPValidationError") == 0
