"""Operations are declared once: routes, rights, description, reference page and clients follow from it."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest
from starlette.requests import Request

from drivebus.cli.remote.http_client import http_request
from drivebus.errors import AuditUnavailable, PermissionDenied, ServiceUnavailable
from drivebus.service.api import handlers
from drivebus.service.api.dispatcher import Dispatcher
from drivebus.service.api.handlers import bound_handlers, handles
from drivebus.service.api.operations import API_PREFIX, OPERATIONS, Audit, Operation, collect_operations
from drivebus.service.api.operations.drives import DriveParams
from drivebus.service.api.operations.outcomes import OutcomeResponse
from drivebus.service.auth.actor import Actor
from drivebus.service.auth.rights import AccessLevel, Right
from drivebus.service.ipc import server
from drivebus.types import Json
from drivebus.values import Text
from drivebus.web import app
from drivebus.web.app import HANDLERS, declared_routes
from drivebus.web.context import actor_of
from drivebus.web.operations import WEB_OPERATIONS
from fixtures.service import LOCAL, running_service
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
    monkeypatch.setattr(app, "routers", app.routers.__wrapped__)


def test_a_new_operation_has_its_route_with_its_right() -> None:
    found = [route for route in declared_routes() if route.path == PATH]
    assert [(route.method, route.access) for route in found] == [("POST", Right.OPERATE)]


async def test_a_new_operation_reaches_the_service_for_those_who_may(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)
    operator, viewer = await harness.log_in("operator"), await harness.log_in("viewer")
    assert (await operator.post(PATH.format(drive="fan-1"))).status_code == 200
    assert (await viewer.post(PATH.format(drive="fan-1"))).status_code == 403
    assert [call[:2] for call in harness.service.calls] == [("drive.polish", {"drive": "fan-1"})]


async def test_a_new_operation_is_described(tmp_path: Path) -> None:
    client = await WebAppHarness(tmp_path).log_in("viewer")
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
    assert http_request(POLISH, {"drive": "fan 1"}) == ("POST", f"{API_PREFIX}/drives/fan%201/polish", b"{}")


async def test_a_new_operation_is_answered_by_the_handler_beside_its_declaration(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(handlers, "HANDLERS", {})

    class Polisher:
        @handles(POLISH)
        async def polish(self, params: DriveParams, actor: Actor) -> Json:
            return {"outcome": {"status": "confirmed", "drive": params.drive, "by": actor.name}}

    async with running_service() as kit:
        dispatcher = Dispatcher(kit.service.plant, bound_handlers([Polisher()]))
        answer = await dispatcher.call("drive.polish", {"drive": "fan-1"}, LOCAL)
        assert answer["outcome"] == {"status": "confirmed", "drive": "fan-1", "by": "tester"}
        assert kit.trail.outcomes("drive.polish") == ["requested", "confirmed"]
        with pytest.raises(PermissionDenied):
            await dispatcher.call("drive.polish", {"drive": "fan-1"}, Actor("eve", frozenset(), "s"))


async def test_a_new_stop_has_the_exceptions_of_a_stop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before the set-up, beyond the limit of pending requests, while the service ends, and without its audit trail."""
    monkeypatch.setattr(handlers, "HANDLERS", {})
    halt = replace(POLISH, name="drive.halt", path="/drives/{drive}/halt", right=Right.STOP, audit=Audit.MEANWHILE)
    monkeypatch.setitem(OPERATIONS, halt.name, halt)

    class Brake:
        @handles(halt)
        async def brake(self, params: DriveParams, actor: Actor) -> Json:
            return {"outcome": {"status": "confirmed"}}

        @handles(POLISH)
        async def polish(self, params: DriveParams, actor: Actor) -> Json:
            return {}

    harness = WebAppHarness(tmp_path)
    operator = await harness.log_in("operator")
    harness.auth.user_file.change(lambda register: type(register)(register.users[:2]))
    assert harness.auth.needs_setup
    assert (await operator.post(PATH.format(drive="fan-1"))).status_code == 409
    assert (await operator.post(f"{API_PREFIX}/drives/fan-1/halt")).status_code == 200
    assert server._is_stop("drive.halt") and not server._is_stop("drive.polish")
    async with running_service() as kit:
        dispatcher = Dispatcher(kit.service.plant, bound_handlers([Brake()]))
        kit.trail.fails_silently = True
        with pytest.raises(AuditUnavailable):
            await dispatcher.call("drive.polish", {"drive": "fan-1"}, LOCAL)
        assert (await dispatcher.call("drive.halt", {"drive": "fan-1"}, LOCAL))["outcome"]
        monkeypatch.setattr(kit.service.plant, "state", "stopping")
        with pytest.raises(ServiceUnavailable):
            await dispatcher.call("drive.polish", {"drive": "fan-1"}, LOCAL)
        assert (await dispatcher.call("drive.halt", {"drive": "fan-1"}, LOCAL))["outcome"]
        monkeypatch.undo()


def test_a_second_handler_of_an_operation_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(handlers, "HANDLERS", {})
    handles(POLISH)(test_a_new_operation_is_described)
    with pytest.raises(ValueError, match="two handlers"):
        handles(POLISH)(test_a_new_operation_is_described)


async def test_every_operation_has_a_handler(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(OPERATIONS, POLISH.name)
    async with running_service() as kit:
        assert kit.service.dispatcher._handlers.keys() == OPERATIONS.keys(), (
            "bind a handler with @handles, and list a new class of handlers in service/app.py"
        )
    assert HANDLERS.keys() == WEB_OPERATIONS.keys()
    assert handlers.HANDLERS.keys() == OPERATIONS.keys() | WEB_OPERATIONS.keys()


def test_an_operation_that_is_declared_twice_is_rejected() -> None:
    module = ModuleType("polishing")
    module.POLISH = POLISH  # type: ignore[attr-defined]
    assert collect_operations(module) == {"drive.polish": POLISH}
    module.POLISH_AGAIN = replace(POLISH, name="drive.polish_again")  # type: ignore[attr-defined]
    with pytest.raises(ValueError, match="declared twice"):
        collect_operations(module)


ENGRAVE = Operation(
    name="plate.engrave",
    right=AccessLevel.SESSION,
    method="POST",
    path="/plates/{drive}",
    params=DriveParams,
    response=OutcomeResponse,
    audit=Audit.REQUIRED,
    summary=Text("Engrave a plate", "刻铭牌"),
)


async def test_a_new_operation_of_the_gateway_is_one_declaration_and_its_handler(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(handlers, "HANDLERS", {})
    monkeypatch.setitem(WEB_OPERATIONS, ENGRAVE.name, ENGRAVE)

    async def engrave(request: Request, params: DriveParams) -> Json:
        return {"drive": params.drive, "by": actor_of(request).name}

    monkeypatch.setitem(HANDLERS, ENGRAVE.name, handles(ENGRAVE)(engrave))
    harness = WebAppHarness(tmp_path)
    viewer, path = await harness.log_in("viewer"), f"{API_PREFIX}/plates/fan-1"
    assert (await viewer.post(path)).json() == {"drive": "fan-1", "by": "viewer"}
    assert (await viewer.post(f"{API_PREFIX}/plates/A%20B")).json()["error"]["code"] == "plant.params"
    assert (await harness.client().post(path)).status_code == 401
    description = (await viewer.get(f"{API_PREFIX}/openapi.json")).json()["paths"][f"{API_PREFIX}/plates/{{drive}}"]
    assert (description["post"]["x-right"], description["post"]["security"]) == (
        "session",
        [{"session": [], "csrf": []}],
    )
    assert http_request(ENGRAVE, {"drive": "fan-1"}) == ("POST", path, b"{}")


def test_every_operation_has_one_route_and_every_route_a_required_access() -> None:
    declared = [(route.method, route.path) for route in declared_routes()]
    assert len(declared) == len(set(declared))
    assert {
        (operation.method, operation.url_path) for operation in (*OPERATIONS.values(), *WEB_OPERATIONS.values())
    } <= set(declared)
    assert all(route.access for route in declared_routes())


def test_no_operation_of_the_gateway_has_the_name_of_one_of_the_service() -> None:
    assert not OPERATIONS.keys() & WEB_OPERATIONS.keys()


@pytest.mark.parametrize(
    "operation", [*OPERATIONS.values(), *WEB_OPERATIONS.values()], ids=lambda operation: operation.name
)
def test_the_example_of_an_operation_fits_its_own_parameters(operation: Operation) -> None:
    assert operation.params.model_validate(json.loads(json.dumps(operation.example)))


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"method": "GET"}, "GET must not change anything"),
        ({"response": None}, "either a response model or media types"),
        ({"media_types": ("text/csv",)}, "either a response model or media types"),
        ({"path": "/motors/{motor}/polish"}, "are no parameters"),
        ({"audit": Audit.MEANWHILE}, "only an operation of the right 'stop'"),
        ({"audit": Audit.SESSION}, "an operation that needs a right is recorded before it is done"),
        ({"audit": Audit.NONE, "moves_motors": True}, "a motion is recorded before it begins"),
        (
            {"audit": Audit.MEANWHILE, "right": Right.STOP, "moves_motors": True},
            "a motion is recorded before it begins",
        ),
    ],
)
def test_a_declaration_that_contradicts_itself_is_rejected(changes: dict[str, object], problem: str) -> None:
    declared = {name: getattr(POLISH, name) for name in Operation.__dataclass_fields__}
    with pytest.raises(ValueError, match=problem):
        Operation(**declared | changes)
