"""The API behind the real middleware: the same errors over every interface, in one shape."""

from __future__ import annotations

import asyncio
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from http.client import HTTPConnection
from pathlib import Path

import httpx
import pytest

from drivebus.errors import DrivebusError
from drivebus.service.api.errors import error_to_json
from drivebus.service.api.operations import API_PREFIX, OPERATIONS
from drivebus.service.auth.actor import Actor
from drivebus.service.auth.rights import ROLE_RIGHTS, Role
from drivebus.service.ipc.client import SocketClient
from drivebus.types import Json
from fixtures.running_service import RunningService, all_states_known, plant_fixture, token
from fixtures.service import WIDEST_LIMITS
from fixtures.web_app import WebAppHarness


async def test_an_unknown_method_is_answered_with_the_known_ones(tmp_path: Path) -> None:
    async with WebAppHarness(tmp_path).client() as client:
        answer = await client.patch(f"{API_PREFIX}/drives/fan-1/waiver")
    assert (answer.status_code, answer.headers["allow"]) == (405, "DELETE, POST")
    assert answer.json()["error"]["code"] == "auth.no_such_method"


@pytest.mark.parametrize("body", [{"name": 5, "password": "x"}, {}, {"name": "a", "password": "b", "x": 1}])
async def test_a_body_that_the_framework_rejects_has_the_common_error_shape(tmp_path: Path, body: object) -> None:
    async with WebAppHarness(tmp_path).client() as client:
        answer = await client.post(f"{API_PREFIX}/login", json=body)
    error = answer.json()["error"]
    assert (answer.status_code, error["kind"], error["code"]) == (422, "InvalidParameters", "plant.params")
    assert error["params"]["faults"] and set(error["text"]) == {"en", "zh"}


# --- with a real plant: the same rejection over every interface, starts that cannot be replayed ---------------------


plant = plant_fixture(grants_waivers=True)


def response(plant: RunningService, role: Role, name: str, params: Json) -> httpx.Response:
    """Return the response of the API to an operation."""
    operation = OPERATIONS[name]
    path = API_PREFIX + operation.path.format(**params)
    rest = {name: value for name, value in params.items() if name not in operation.path_params}
    headers = {"Authorization": f"Bearer {token(role)}"}
    given: Json = {"json": rest} if operation.has_body else {"params": rest}
    return httpx.request(operation.method, plant.url + path, headers=headers, timeout=30.0, **given)


def test_a_check_of_a_configuration_ends_when_its_client_disconnects(plant: RunningService) -> None:
    checks: list[bool] = []

    async def until_cancelled(*_: object) -> None:
        checks.append(False)
        try:
            await asyncio.Event().wait()
        except asyncio.CancelledError:
            checks[0] = True
            raise

    connection = HTTPConnection(plant.url.partition("://")[2])
    headers = {"Authorization": f"Bearer {token(Role.ENGINEER)}", "Content-Type": "application/json"}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plant.kit.service.reload._check, "check", until_cancelled)
        connection.request("POST", f"{API_PREFIX}/configuration/check", '{"text": "x"}', headers)
        for expected in ([False], [True]):
            for _ in range(6000):
                if checks == expected:
                    break
                time.sleep(0.01)
            assert checks == expected
            connection.close()


def rest(plant: RunningService, role: Role, name: str, params: Json) -> Json:
    """Return the result or the error of the API."""
    found: Json = response(plant, role, name, params).json()
    return found


def test_a_cancellable_request_without_a_body_is_answered(plant: RunningService) -> None:
    answer = rest(plant, Role.ENGINEER, "audit.verify", {})
    assert answer["ok"] is True and answer["entries"] > 0


def by_socket(plant: RunningService, actor: Actor, operation: str, params: Json) -> Json:
    """Return the same over ``plant.sock``."""

    async def call() -> Json:
        client = SocketClient(plant.socket)
        try:
            return await client.call(operation, params, actor)
        except DrivebusError as error:
            return {"error": error_to_json(error)}
        finally:
            await client.close()

    return asyncio.run(call())


FIELDS = [
    ("drive.limits", {"drive": "fan-1", **WIDEST_LIMITS, "maximum_hz": 400.0}, Role.OPERATOR),
    ("parameters.write", {"drive": "fan-1", "values": {"F1.10": 1.0}}, Role.OPERATOR),
    ("parameters.write", {"drive": "fan-1", "values": {"F1.10": 1.0}, "save": True}, Role.OPERATOR),
    ("waiver.grant", {"drive": "fan-1", "reason": "because"}, Role.OPERATOR),
    ("configuration.reload", {}, Role.OPERATOR),
    ("drive.run", {"drive": "fan-1", "frequency_hz": 5.0}, Role.VIEWER),
    ("drive.stop", {"drive": "fan-1"}, Role.VIEWER),
    ("audit.list", {}, Role.OPERATOR),
]


@pytest.mark.parametrize(("operation", "params", "role"), FIELDS, ids=lambda value: str(value)[:30])
def test_who_may_set_a_frequency_may_not_change_what_bounds_it(
    plant: RunningService, operation: str, params: Json, role: Role
) -> None:
    """Over REST the middleware denies, over the socket the plant itself: neither relies on the other."""
    actor = Actor("x", ROLE_RIGHTS[role], f"s-{role}")
    denied = response(plant, role, operation, params)
    assert denied.status_code == 403
    answers = [denied.json(), by_socket(plant, actor, operation, params)]
    assert [answer["error"]["kind"] for answer in answers] == ["AccessDenied", "PermissionDenied"]


BEYOND = [
    ("drive.set_frequency", {"drive": "fan-1", "frequency_hz": 60.0}),
    ("drive.set_frequency", {"drive": "fan-1", "frequency_hz": "25.0"}),
    ("drive.set_frequency", {"drive": "fan-1", "frequency_hz": True}),
    ("drive.set_frequency", {"drive": "fan-1", "frequency_hz": 10**400}),
    ("drive.set_frequency", {"drive": "fan-1", "frequency_hz": 25.0, "force": True}),
    ("drive.limits", {"drive": "fan-1", **WIDEST_LIMITS, "maximum_hz": 400.0}),
    ("parameters.write", {"drive": "fan-1", "values": {"F9.99": 1.0}}),
    ("parameters.write", {"drive": "fan-1", "values": {"output_frequency": 1.0}}),
    ("drive.run", {"drive": "no-such-drive", "frequency_hz": 5.0}),
]


@pytest.mark.parametrize(("operation", "params"), BEYOND, ids=lambda value: str(value)[:60])
def test_a_command_beyond_a_limit_is_rejected_with_the_same_text_over_every_interface(
    plant: RunningService, operation: str, params: Json
) -> None:
    rest(plant, Role.ENGINEER, "lease.take", {"drive": "fan-1"})
    actor = Actor("engineer/test", ROLE_RIGHTS[Role.ENGINEER], "token-id-engineer")
    rejected = response(plant, Role.ENGINEER, operation, params)
    assert rejected.json() == by_socket(plant, actor, operation, params)
    assert rejected.status_code == (404 if params["drive"] == "no-such-drive" else 422)


def test_a_start_that_waited_for_a_suspended_page_is_not_done_and_a_stop_is(plant: RunningService) -> None:
    """The client may have given up meanwhile, and the motor would start seconds after the click."""
    fan: Json = {"drive": "fan-1"}
    rest(plant, Role.ENGINEER, "lease.take", fan)
    plant.run_in_loop(lambda: all_states_known(plant))
    arm_token = rest(plant, Role.ENGINEER, "drive.arm", fan)["arm_token"]
    start = fan | {"frequency_hz": 5.0, "arm_token": arm_token}

    async def suspend() -> None:
        suspended.set()
        time.sleep(2.6)  # noqa: ASYNC251  as SIGSTOP would

    suspended = threading.Event()
    with ThreadPoolExecutor(3) as pool:
        suspension = pool.submit(plant.run_in_loop, suspend)
        assert suspended.wait(10.0)
        late_start = pool.submit(response, plant, Role.ENGINEER, "drive.run", start)
        late_stop = pool.submit(response, plant, Role.ENGINEER, "drive.stop", {"drive": "fan-2"})
        suspension.result()
    error = late_start.result().json()["error"]
    assert (late_start.result().status_code, error["code"]) == (409, "plant.waited_too_long")
    assert error["may_be_running"] is False
    assert error["text"]["en"].startswith("the command may have waited 2.")
    assert late_stop.result().json()["outcome"]["status"] == "confirmed"
    time.sleep(2.8)
    rest(plant, Role.ENGINEER, "lease.renew", fan)
    assert (
        rest(plant, Role.ENGINEER, "drive.run", start)["outcome"]["status"] == "confirmed"
    )  # its token is not used up
    rest(plant, Role.ENGINEER, "drive.stop", fan)


def test_a_recorded_start_cannot_be_replayed(plant: RunningService) -> None:
    """The start is rejected in another session and after a stop too."""
    fan: Json = {"drive": "fan-1"}
    rest(plant, Role.ENGINEER, "lease.take", fan)
    arm = rest(plant, Role.ENGINEER, "drive.arm", fan)["arm_token"]
    start = fan | {"frequency_hz": 5.0, "arm_token": arm}
    assert rest(plant, Role.ENGINEER, "drive.run", fan | {"frequency_hz": 5.0})["error"]["kind"] == "ArmRequired"
    assert rest(plant, Role.OPERATOR, "drive.run", start)["error"]["kind"] == "ControlNotHeld"
    assert rest(plant, Role.ENGINEER, "drive.run", start)["outcome"]["status"] == "confirmed"
    assert rest(plant, Role.ENGINEER, "drive.run", start)["error"]["code"] == "plant.arm_void"
    arm = rest(plant, Role.ENGINEER, "drive.arm", fan)["arm_token"]
    rest(plant, Role.ENGINEER, "drive.stop", fan)
    voided = fan | {"frequency_hz": 5.0, "arm_token": arm}
    assert rest(plant, Role.ENGINEER, "drive.run", voided)["error"]["code"] == "plant.arm_void"


def test_a_stop_needs_no_lease(plant: RunningService) -> None:
    rest(plant, Role.ENGINEER, "lease.take", {"drive": "pump-1"})
    assert rest(plant, Role.OPERATOR, "drive.stop", {"drive": "pump-1"})["outcome"]["status"] == "confirmed"


@pytest.mark.parametrize(
    ("days", "status"), [(30.0, 200), (30.5, 422), ("30", 422), (True, 422), (367, 422), (1e300, 422)]
)
async def test_a_whole_number_of_days_may_be_written_with_a_point(tmp_path: Path, days: object, status: int) -> None:
    """Regression, found by schemathesis: 30.0 fits the description and was rejected."""
    client = await WebAppHarness(tmp_path).log_in("engineer")
    body = {"name": "t", "rights": ["view"], "days": days}
    assert (await client.post(f"{API_PREFIX}/tokens", json=body)).status_code == status
    described = (await client.get(f"{API_PREFIX}/openapi.json")).json()["paths"][f"{API_PREFIX}/tokens"]["post"]
    fields = described["requestBody"]["content"]["application/json"]["schema"]["properties"]
    assert (fields["days"]["minimum"], fields["days"]["maximum"]) == (1, 366)
    await client.aclose()
