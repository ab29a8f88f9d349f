"""The gateways behind the real door: the same refusal whichever way a request comes (S08, S09), and its one shape."""

from __future__ import annotations

from pathlib import Path

import pytest

from doorkit import House
from drivebus.gateways.rest.table import PREFIX, ROUTES
from drivebus.web.rights import TABLE


def test_s02_the_door_knows_every_route_with_the_right_that_the_plant_asks() -> None:
    door = {(entry.method, entry.path): str(entry.need) for entry in TABLE}
    ours = {(route.method, PREFIX + route.path): str(route.operation.right) for route in ROUTES}
    assert {key: door.get(key) for key in ours} == ours


async def test_a_method_that_an_address_does_not_have_is_told_those_that_it_has(tmp_path: Path) -> None:
    async with House(tmp_path).client() as client:
        answer = await client.patch(f"{PREFIX}/drives/fan-1/waiver")
    assert (answer.status_code, answer.headers["allow"]) == (405, "DELETE, POST")
    assert answer.json()["error"]["status"] == 405


@pytest.mark.parametrize("body", [{"name": 5, "password": "x"}, {}, {"name": "a", "password": "b", "x": 1}])
async def test_a_body_that_the_framework_checks_is_refused_in_the_one_shape(tmp_path: Path, body: object) -> None:
    async with House(tmp_path).client() as client:
        answer = await client.post(f"{PREFIX}/login", json=body)
    error = answer.json()["error"]
    assert (answer.status_code, error["kind"], error["code"]) == (422, "ParamsError", "plant.params")
    assert error["params"]["faults"] and set(error["text"]) == {"en", "zh"}
