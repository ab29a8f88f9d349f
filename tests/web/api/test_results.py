"""Every operation of a running service answers what its description declares: no field is missing or undeclared."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import jsonschema_rs
import pytest

from drivebus.service.api.operations import API_PREFIX, OPERATIONS, Operation
from drivebus.service.api.operations.operation import EmptyResponse
from drivebus.service.auth.rights import Role
from drivebus.simulator.motor import Trip
from drivebus.types import Json
from drivebus.values import Text
from drivebus.web.operations import WEB_OPERATIONS
from fixtures.running_service import RunningService, plant_fixture, token
from fixtures.service import SHOP_FILE, WIDEST_LIMITS
from fixtures.web_app import PASSWORD, WebAppHarness

ALL_OPERATIONS = OPERATIONS | WEB_OPERATIONS
FREE_OBJECTS = {
    "AuditRecordObject.params": "parameters of any operation",
    "ErrorObject.params": "values of a sentence, each with its own names",
    "ExchangeObject.params": "values of a sentence",
    "IncidentResponse.raised": "as the version of drivebus that recorded it wrote it",
    "IncidentResponse.view": "as the version of drivebus that recorded it wrote it",
    "OpenApiResponse.components": "described by the specification of OpenAPI",
    "OpenApiResponse.info": "described by the specification of OpenAPI",
    "OpenApiResponse.paths": "described by the specification of OpenAPI",
    "OutcomeObject.params": "values of a sentence",
    "StartBlockerObject.params": "values of a sentence",
}
"""Fields that are objects of any content, with the reason."""
OPEN_OBJECTS = {"AuditProblemObject"}
"""Objects whose further members depend on one that is declared."""


plant = plant_fixture(grants_waivers=True)


@pytest.fixture(scope="module")
def description(plant: RunningService) -> Json:
    headers = {"Authorization": f"Bearer {token(Role.ENGINEER)}"}
    found: Json = (
        httpx.get(f"{plant.url}{API_PREFIX}/openapi.json", headers=headers, timeout=60.0).raise_for_status().json()
    )
    return found


def result_content(description: Json, operation: Operation) -> Json:
    """Return the described content of a result, by media type."""
    responses = description["paths"][operation.url_path][operation.method.lower()]["responses"]
    found: Json = responses["200"]["content"]
    return found


@pytest.mark.parametrize("operation", ALL_OPERATIONS.values(), ids=lambda operation: operation.name)
def test_the_result_of_every_operation_is_described(description: Json, operation: Operation) -> None:
    content = result_content(description, operation)
    if operation.media_types:
        assert content.keys() == set(operation.media_types)
        return
    name = content["application/json"]["schema"]["$ref"].rpartition("/")[2]
    found = description["components"]["schemas"][name]
    assert found["properties"] or operation.response is EmptyResponse


def test_a_field_of_a_result_is_no_object_of_any_content(description: Json) -> None:
    found = {
        f"{name}.{field}"
        for name, schema in description["components"]["schemas"].items()
        for field, definition in schema.get("properties", {}).items()
        if is_free(definition)
    }
    assert found == FREE_OBJECTS.keys()


def is_free(schema: Any) -> bool:
    """Return whether a schema, or one within it, allows any content."""
    if not isinstance(schema, dict):
        return True
    if "$ref" in schema or "enum" in schema or "const" in schema:
        return False
    if "anyOf" in schema:
        return any(map(is_free, schema["anyOf"]))
    within = {"array": "items", "object": "additionalProperties"}
    kind = schema.get("type")
    return kind is None or (kind in within and is_free(schema.get(within[kind])))


# --- the answers of a running service -------------------------------------------------------------------------------


class CheckedClient:
    """Client of a service that checks every answer against its description."""

    def __init__(self, url: str, description: Json, **headers: str) -> None:
        self.client = httpx.Client(base_url=url, headers=headers, timeout=60.0)
        self.description = description
        self.closed_schemas = {
            name: schema | ({} if name in OPEN_OBJECTS else {"additionalProperties": False})
            for name, schema in description["components"]["schemas"].items()
        }
        """Schemas that allow no undeclared field."""
        self.checked: set[str] = set()
        """Names of the operations whose result was checked."""

    def log_in(self, role: Role) -> None:
        self.client.headers["X-Drivebus-CSRF"] = self.call("login", name=str(role), password=PASSWORD)["csrf"]

    def call(self, name: str, /, status: int = 200, **params: Any) -> Json:
        """Return the checked result of an operation, or its error where ``status`` is that of one."""
        operation = ALL_OPERATIONS[name]
        rest = {key: value for key, value in params.items() if key not in operation.path_params}
        given: Json = {"json": rest} if operation.has_body else {"params": rest}
        answer = self.client.request(operation.method, operation.url_path.format(**params), **given)
        assert answer.status_code == status, f"{name}: {answer.text}"
        self.check(operation, answer)
        return answer.json() if answer.headers["content-type"] == "application/json" else {}

    def check(self, operation: Operation, answer: httpx.Response) -> None:
        responses = self.description["paths"][operation.url_path][operation.method.lower()]["responses"]
        content = responses[str(answer.status_code)]["content"]
        media_type = answer.headers["content-type"].partition(";")[0]
        assert media_type in content, f"{operation.name}: {media_type}"
        if media_type == "application/json":
            schema = content[media_type]["schema"] | {"components": {"schemas": self.closed_schemas}}
            found = [
                f"{error.instance_path}: {error.message}" for error in jsonschema_rs.iter_errors(schema, answer.json())
            ]
            assert not found, (operation.name, found)
        if answer.status_code == 200:
            self.checked.add(operation.name)

    def wait_until(self, what: Callable[[], bool], limit_s: float = 20.0) -> None:
        deadline = time.monotonic() + limit_s
        while not what():
            assert time.monotonic() < deadline
            time.sleep(0.1)


def test_a_running_service_answers_what_is_described_without_an_undeclared_field(
    plant: RunningService, description: Json, tmp_path: Path
) -> None:
    """Every operation is called in a plant with a running, a tripped and a stopped drive."""
    api = CheckedClient(plant.url, description)
    api.log_in(Role.ENGINEER)
    other = CheckedClient(plant.url, description, Authorization=f"Bearer {token(Role.OPERATOR)}")
    api.wait_until(lambda: all(drive["presence"] == "online" for drive in api.call("drives.list")["drives"]))
    command_drives(api)
    hold_and_pause(api)
    request_control(api, other)
    run_comm_loss_test(api)
    trip_and_read_alarms(api, plant)
    read_history(api)
    fail_to_write_history(api, plant)
    use_groups(api)
    stop_everything(api)
    configure(api, plant, tmp_path)
    administer(plant, description, api)
    set_up(description, tmp_path, api)
    missing = ALL_OPERATIONS.keys() - api.checked - other.checked
    assert not missing, "call each of these operations in one of the steps above"


def arm(api: CheckedClient, drive: str, **params: Any) -> Any:
    """Take control and return the token of a start, which only a remote start needs."""
    api.call("lease.take", drive=drive)
    return api.call("drive.arm", drive=drive, **params)["arm_token"]


def command_drives(api: CheckedClient) -> None:
    api.call("waiver.revoke", drive="fan-1")
    assert api.call("drives.get", drive="fan-1")["start_blockers"]
    api.call("waiver.grant", drive="fan-1", reason="test bench")
    api.call("drive.limits", drive="fan-1", **WIDEST_LIMITS | {"maximum_hz": 45.0})
    token = arm(api, "fan-1")
    assert api.call("drive.run", drive="fan-1", frequency_hz=5.0, arm_token=token)["outcome"]["frames"]
    api.call("drive.set_frequency", drive="fan-1", frequency_hz=6.0)
    assert api.call("drive.set_frequency", drive="fan-1", frequency_hz=60.0, status=422)["error"]
    api.call("drives.get", drive="fan-1")
    api.call("drive.stop", drive="fan-1")
    api.call("lease.renew", drive="fan-1")
    jog = api.call("drive.jog", drive="fan-1", frequency_hz=5.0, arm_token=arm(api, "fan-1"))["jog"]
    api.call("drive.jog_renew", drive="fan-1", jog=jog)
    api.call("drive.jog_end", drive="fan-1", jog=jog)
    api.call("parameters.read", drive="fan-1", names=["F0.1", "F1.07"])
    api.call("parameters.write", drive="fan-1", values={"F1.10": 1.0})
    api.call("identity.read", drive="fan-1")
    assert api.call("loopback.test", drive="pump-1", count=3)["complete"]
    assert api.call("loopback.test", drive="pump-1", count=101, status=422)["error"]
    assert api.call("loopback.test", drive="fan-1", status=422)["error"]["code"] == "drives.cannot"
    api.call("drives.profile", drive="fan-1")
    api.call("drives.statistics", drive="fan-1")
    api.call("plant.statistics")
    for model in (profile["model"] for profile in api.call("models.list")["models"]):
        api.call("models.get", model=model)


def hold_and_pause(api: CheckedClient) -> None:
    api.call("drive.run", drive="pump-1", frequency_hz=20.0, arm_token=arm(api, "pump-1"))
    api.call("drive.hold_ramp", drive="pump-1", seconds=0.1)
    api.call("drive.pause", drive="pump-1")
    api.call("drive.stop", drive="pump-1")
    api.call("lease.release", drive="pump-1")


def request_control(api: CheckedClient, other: CheckedClient) -> None:
    for drive, answer in (("pump-1", "decline"), ("fan-1", "grant")):
        api.call("lease.take", drive=drive)
        asked = other.call("control_request.make", drive=drive, reason="shift change")["control_request"]["id"]
        assert api.call("drives.get", drive=drive)["control_request"]
        api.call(f"control_request.{answer}", drive=drive, request=asked)
    api.call("control_requests.make", drives=["fan-1", "pump-1"])
    api.call("control_requests.withdraw", drives=["fan-1"])
    other.call("lease.take", drive="pump-2")
    api.call("control_request.make", drive="pump-2")
    api.call("control_request.withdraw", drive="pump-2")
    for drive in ("fan-1", "pump-2"):
        other.call("lease.release", drive=drive)


def run_comm_loss_test(api: CheckedClient) -> None:
    token = arm(api, "fan-2", purpose="comm_loss_test")
    api.call("comm_loss.test", drive="fan-2", frequency_hz=5.0, silence_s=8.0, arm_token=token)

    def tested() -> Json:
        api.call("lease.renew", drive="fan-2")
        found: Json = api.call("drives.get", drive="fan-2")["comm_loss"]
        return found

    api.wait_until(lambda: (tested()["test"] or {}).get("phase") == "silent")
    api.call("comm_loss.test_read", drive="fan-2")
    api.wait_until(lambda: tested()["test"] is None, 60.0)
    api.call("comm_loss.discard", drive="fan-2")
    api.call("drive.stop", drive="fan-2")


def trip_and_read_alarms(api: CheckedClient, plant: RunningService) -> None:
    api.call("drive.run", drive="fan-1", frequency_hz=5.0, arm_token=arm(api, "fan-1"))
    plant.run_in_loop(lambda: asyncio.sleep(0, plant.kit.station("fan-1").trip(Trip.UNDERVOLTAGE)))

    def raised() -> list[Json]:
        return [alarm for alarm in api.call("alarms.list")["active"] if alarm["kind"] == "fault" and alarm["incident"]]

    api.wait_until(lambda: bool(raised()))
    assert api.call("drives.get", drive="fan-1")["fault"]
    alarm = raised()[0]
    for name, params in (("acknowledge", {}), ("shelve", {"minutes": 60, "reason": "known"}), ("unshelve", {})):
        api.call(f"alarms.{name}", alarms=[alarm["id"], "no-such-alarm"], **params)
        api.call(f"alarm.{name}", alarm=alarm["id"], **params)
    api.call("incident.note", incident=alarm["incident"], note="breaker was open")
    api.wait_until(lambda: api.call("incidents.get", incident=alarm["incident"])["parameters"] is not None)
    assert api.call("incidents.list")["items"] and api.call("alarms.history")["items"]
    api.call("drive.reset", drive="fan-1")


def read_history(api: CheckedClient) -> None:
    api.wait_until(lambda: bool(api.call("history.tags")["tags"]))
    now_ms = round(time.time() * 1000)
    span = {"tags": ["fan-1.output_frequency"], "from_ms": now_ms - 60_000, "to_ms": now_ms}
    api.call("history.trend", **span)
    api.call("history.export", **span)
    assert api.call("history.events")["items"]
    assert [entry for entry in api.call("audit.list")["items"] if entry["frames"]]
    assert api.call("audit.verify")["ok"]
    for bus in api.call("buses.list")["buses"]:
        api.call("buses.get", bus=bus["id"])
        assert api.call("buses.frames", bus=bus["id"])["frames"]


def fail_to_write_history(api: CheckedClient, plant: RunningService) -> None:
    async def statistics() -> Json:
        plant.kit.service.plant.historian.writer.problem = Text("full", "已满")
        return await plant.kit.call("plant.statistics")

    found = plant.run_in_loop(statistics)
    assert found["history"]["problem"]
    api.check(OPERATIONS["plant.statistics"], httpx.Response(200, json=found))


def use_groups(api: CheckedClient) -> None:
    for drive in ("fan-1", "fan-2"):
        api.call("lease.take", drive=drive)
    token = api.call("group.arm", group="fans")["arm_token"]
    api.call("group.start", group="fans", frequency_hz=5.0, arm_token=token)
    api.call("groups.list")
    api.call("group.set_frequency", group="fans", frequency_hz=6.0)
    api.call("group.stop", group="fans")


def stop_everything(api: CheckedClient) -> None:
    api.call("plant.stop")
    assert api.call("plant.get")["stop_all"]["buses"]
    api.call("start_inhibit.release", drive="fan-1")
    api.call("start_inhibits.release", all=True)
    api.call("waivers.grant", all=True, reason="test bench")


def configure(api: CheckedClient, plant: RunningService, directory: Path) -> None:
    file = directory / "plant.toml"
    file.write_text(SHOP_FILE)
    file.chmod(0o600)
    plant.kit.service.plant.config = replace(plant.kit.service.plant.config, source=str(file))
    api.call("configuration.get")
    api.call("configuration.check", text="[plant]\n")
    assert api.call("configuration.check", text=SHOP_FILE)["difference"]["removed"]
    api.call("configuration.reload")


def administer(plant: RunningService, description: Json, api: CheckedClient) -> None:
    admin = CheckedClient(plant.url, description)
    admin.call("health.get")
    admin.call("session.get")
    admin.call("login", status=401, name="administrator", password="wrong")
    admin.log_in(Role.ADMINISTRATOR)
    for name in ("session.get", "session.activity", "openapi.get", "metrics.get", "users.list"):
        admin.call(name)
    admin.call("unlock", password=PASSWORD)
    admin.call("user.add", name="zhou", role="viewer", password="a long pass phrase")
    admin.call("user.change", user="zhou", disabled=True)
    admin.call("user.remove", user="zhou")
    added = admin.call("token.add", name="report", rights=["view"], days=1)["token"]["id"]
    admin.call("tokens.list")
    admin.call("token.remove", token=added)
    second = CheckedClient(plant.url, description)
    second.log_in(Role.ADMINISTRATOR)
    ids = [session["id"] for session in admin.call("sessions.list")["sessions"] if not session["current"]]
    admin.call("session.end", session=ids[0], password=PASSWORD)
    code = plant.run_in_loop(lambda: plant.access.issue_code("viewer", 60.0))
    second.call("login-code", code=code)
    changed = admin.call("password", old=PASSWORD, new="another long phrase")
    admin.client.headers["X-Drivebus-CSRF"] = changed["csrf"]
    admin.call("logout", all=True)
    api.checked |= admin.checked | second.checked


def set_up(description: Json, directory: Path, api: CheckedClient) -> None:
    """The first administrator is created in another plant, which has none."""

    async def answer() -> httpx.Response:
        harness = WebAppHarness(directory, users=False)
        given = {"secret": harness.auth.setup_secret.issue(), "name": "wang", "password": "a long pass phrase"}
        async with harness.client() as client:
            return await client.post(f"{API_PREFIX}/setup", json=given)

    found = asyncio.run(answer())
    assert found.status_code == 200
    api.check(ALL_OPERATIONS["set-up"], found)
