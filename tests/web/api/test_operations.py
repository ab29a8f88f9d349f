"""One declaration per operation: routes, rights, description, reference page and clients follow from it."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from drivebus.cli.remote.http_client import http_request
from drivebus.service.api.operations import OPERATIONS, Audit, Operation
from drivebus.service.api.operations.drives import DriveParams, OutcomeResponse
from drivebus.service.auth.rights import Right
from drivebus.values import Text
from drivebus.web.api.routes import API_PREFIX
from drivebus.web.app import declared_routes
from fixtures.web_app import WebAppHarness

POLISH = Operation(
    name="drive.polish",
    right=Right.OPERATE,
    method="POST",
    path="/drives/{drive}/polish",
    params=DriveParams,
    response=OutcomeResponse,
    audit=Audit.REQUIRED,
    summary=Text("Polish a drive", "擦亮变频器"),
)
PATH = f"{API_PREFIX}/drives/{{drive}}/polish"


@pytest.fixture(autouse=True)
def polish(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(OPERATIONS, POLISH.name, POLISH)


def test_a_new_operation_has_its_route_with_its_right() -> None:
    found = [route for route in declared_routes() if route.path == PATH]
    assert [(route.method, route.access) for route in found] == [("POST", Right.OPERATE)]


async def test_a_new_operation_reaches_the_service_for_those_who_may(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path, is_shared=False)
    operator, viewer = await harness.log_in("operator"), await harness.log_in("viewer")
    assert (await operator.post(PATH.format(drive="fan-1"))).status_code == 200
    assert (await viewer.post(PATH.format(drive="fan-1"))).status_code == 403
    assert [call[:2] for call in harness.service.calls] == [("drive.polish", {"drive": "fan-1"})]


async def test_a_new_operation_is_described(tmp_path: Path) -> None:
    client = await WebAppHarness(tmp_path, is_shared=False).log_in("viewer")
    found = (await client.get(f"{API_PREFIX}/openapi.json")).json()["paths"][PATH]["post"]
    assert (found["summary"], found["x-right"]) == ("Polish a drive", "operate")
    assert found["responses"]["200"]["content"]["application/json"]["schema"]["$ref"].endswith("/OutcomeResponse")
    assert found["parameters"][0]["example"] == "fan-1"


@pytest.mark.parametrize(("language", "summary"), [("en", "Polish a drive"), ("zh", "擦亮变频器")])
def test_a_new_operation_is_on_the_reference_page(language: str, summary: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", [str(Path(__file__).parents[3] / "docs"), *sys.path])
    from generator import rest_reference

    page = rest_reference.parts(language)["operations"]
    assert f"### `POST {PATH}`" in page and summary in page


def test_a_new_operation_is_known_to_the_command_lines_client() -> None:
    assert http_request("drive.polish", {"drive": "fan 1"}) == ("POST", f"{API_PREFIX}/drives/fan%201/polish", b"{}")


def test_every_operation_has_one_route_and_every_route_a_required_access() -> None:
    declared = [(route.method, route.path) for route in declared_routes()]
    assert len(declared) == len(set(declared))
    assert {(one.method, API_PREFIX + one.path) for one in OPERATIONS.values()} <= set(declared)
    assert all(route.access for route in declared_routes())


@pytest.mark.parametrize("operation", OPERATIONS.values(), ids=lambda operation: operation.name)
def test_the_example_of_an_operation_fits_its_own_parameters(operation: Operation) -> None:
    assert operation.params.model_validate(json.loads(json.dumps(operation.example)))


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"method": "GET"}, "GET must not change anything"),
        ({"path": "/motors/{motor}/polish"}, "are no parameters"),
        ({"audit": Audit.AFTER}, "only an operation of the right 'stop'"),
    ],
)
def test_a_declaration_that_contradicts_itself_is_rejected(changes: dict[str, object], problem: str) -> None:
    declared = {name: getattr(POLISH, name) for name in Operation.__dataclass_fields__}
    with pytest.raises(ValueError, match=problem):
        Operation(**declared | changes)
