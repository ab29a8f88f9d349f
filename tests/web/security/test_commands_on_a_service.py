"""Commands through the whole web app on a real service over simulated drives: only the frames on the bus count."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Awaitable, Callable
from email.utils import formatdate
from pathlib import Path
from typing import Any

import pytest
from httpx import AsyncClient

from drivebus.bus.trace import TraceEvent
from drivebus.service.auth.rights import ROLE_RIGHTS, AccessLevel, Role
from drivebus.testing.virtual_time import run
from drivebus.web.app import declared_routes
from drivebus.web.route import WEBSOCKET
from fixtures.service import WIDEST_LIMITS, ServiceKit, running_service
from fixtures.web_app import WebAppHarness

Scenario = Callable[[ServiceKit, WebAppHarness], Awaitable[None]]


def on_a_plant(directory: Path, scenario: Scenario) -> None:
    """Run ``scenario`` once every drive has answered."""

    async def whole() -> None:
        async with running_service() as kit:
            harness = WebAppHarness(directory, service=kit.service)
            harness.aggregator.__init__(kit.service, harness.clock)  # type: ignore[misc]
            await asyncio.sleep(5)
            await kit.grant_waivers()
            await scenario(kit, harness)

    run(whole())


async def started(client: AsyncClient, drive: str = "fan-1", hz: float = 20.0) -> Any:
    """Take the lease, arm and run as the page does."""
    assert (await client.post(f"/api/v1/drives/{drive}/lease")).status_code == 200
    arm = (await client.post(f"/api/v1/drives/{drive}/arm")).json()["arm_token"]
    return await client.post(f"/api/v1/drives/{drive}/run", json={"frequency_hz": hz, "arm_token": arm})


class SentFrames:
    """Set of distinct frames sent on all buses; polls repeat the same frames."""

    def __init__(self, kit: ServiceKit) -> None:
        self.sent: set[bytes] = set()
        for line in kit.service.plant.buses.values():
            line.bus.trace(self._note)

    def _note(self, event: TraceEvent) -> None:
        if event.kind == "sent":
            self.sent.add(event.data)


def test_a_user_without_the_right_sends_no_frame(tmp_path: Path) -> None:
    """Requests without credential, with a forged one and as each weaker role leave only polls on the buses."""

    async def scenario(kit: ServiceKit, harness: WebAppHarness) -> None:
        frames = SentFrames(kit)
        await asyncio.sleep(10)
        polls = set(frames.sent)
        assert polls
        anonymous_clients = [
            harness.client(),
            harness.client(authorization="Bearer dbt_x"),
            harness.client(cookie="drivebus_session=x"),
        ]
        clients = [(None, client) for client in anonymous_clients]
        clients += [
            (ROLE_RIGHTS[role], await harness.log_in(role)) for role in (Role.VIEWER, Role.OPERATOR, Role.ENGINEER)
        ]
        for rights, client in clients:
            for entry in declared_routes():
                if entry.method == WEBSOCKET or entry.access is AccessLevel.PUBLIC or entry.access in (rights or ()):
                    continue
                if rights is not None and entry.access is AccessLevel.SESSION:
                    continue
                path = re.sub("{drive}", "fan-1", re.sub("{group}", "fans", entry.path))
                answer = await client.request(entry.method, path, json={"frequency_hz": 20.0, "values": {"F0.1": 1.0}})
                assert answer.status_code == (401 if rights is None else 403), (entry, answer.text)
        await asyncio.sleep(2)
        assert frames.sent == polls
        assert [entry for entry in kit.trail.entries if entry.what == "refused"]

    on_a_plant(tmp_path, scenario)


def test_a_replayed_start_starts_nothing(tmp_path: Path) -> None:
    """The same bytes with cookie and CSRF token are sent after the drive was stopped, and from another session."""

    async def scenario(kit: ServiceKit, harness: WebAppHarness) -> None:
        client = await harness.log_in("operator")
        done = await started(client)
        assert done.json()["outcome"]["status"] == "confirmed", done.text
        recorded = done.request
        assert (await client.post("/api/v1/drives/fan-1/stop")).json()["outcome"]["status"] == "confirmed"
        station = kit.station("fan-1")
        for wait_s in (0.0, 1.0, 60.0):
            await asyncio.sleep(wait_s)
            await client.post("/api/v1/drives/fan-1/lease")
            again = await client.send(
                client.build_request("POST", recorded.url, content=recorded.content, headers=recorded.headers)
            )
            assert again.status_code == 409 and again.json()["error"]["kind"] == "ArmRequired", again.text
            assert station.motor.starts == 1 and not station.motor.energised
        assert (await client.post("/api/v1/logout")).status_code == 200
        cookies = dict(recorded.headers)
        again = await harness.client().request("POST", recorded.url, content=recorded.content, headers=cookies)
        assert again.status_code == 401

    on_a_plant(tmp_path, scenario)


def test_an_arm_token_is_valid_in_its_own_session_only(tmp_path: Path) -> None:
    async def scenario(kit: ServiceKit, harness: WebAppHarness) -> None:
        ann, eve = await harness.log_in("operator"), await harness.log_in("engineer")
        assert (await ann.post("/api/v1/drives/fan-1/lease")).status_code == 200
        arm = (await ann.post("/api/v1/drives/fan-1/arm")).json()["arm_token"]
        assert (await eve.post("/api/v1/drives/fan-2/lease")).status_code == 200
        for client, drive in ((eve, "fan-1"), (eve, "fan-2"), (ann, "fan-2")):
            answer = await client.post(f"/api/v1/drives/{drive}/run", json={"frequency_hz": 20.0, "arm_token": arm})
            assert answer.status_code == 409, answer.text
        assert [kit.station(drive).motor.starts for drive in ("fan-1", "fan-2")] == [0, 0]

    on_a_plant(tmp_path, scenario)


@pytest.mark.parametrize("skew_s", [-86_400, 86_400])
def test_a_clock_that_is_a_day_off_changes_nothing(skew_s: int, tmp_path: Path) -> None:
    """Only monotonic time counts: no clock of the client in a header or body, and no wall clock of the server."""

    async def scenario(kit: ServiceKit, harness: WebAppHarness) -> None:
        client = await harness.log_in("operator")
        real = kit.service.plant.wall_ms
        kit.service.plant.wall_ms = lambda: real() + skew_s * 1000
        when = formatdate(kit.service.plant.wall_ms() / 1000)
        client.headers.update({"date": when, "x-request-time": when, "if-unmodified-since": when})
        assert (await started(client)).json()["outcome"]["status"] == "confirmed"
        message = await client.post("/api/v1/drives/fan-1/set-frequency", json={"frequency_hz": 21.0, "time_ms": 0})
        assert message.status_code == 422, "no client sets the plant's time"
        await client.post("/api/v1/drives/fan-1/lease/renew")
        kit.service.plant.wall_ms = real
        message = await client.post("/api/v1/drives/fan-1/set-frequency", json={"frequency_hz": 21.0})
        assert message.status_code == 200 and kit.station("fan-1").motor.target_hz == 21.0, message.text
        assert (await client.post("/api/v1/drives/fan-1/stop")).json()["outcome"]["status"] == "confirmed"

    on_a_plant(tmp_path, scenario)


FIELDS: list[tuple[str, str, Any]] = [
    ("PUT", "/drives/fan-1/limits", {**WIDEST_LIMITS, "maximum_hz": 50.0}),
    ("POST", "/drives/fan-1/parameters/write", {"values": {"F0.1": 1.0}}),
    ("POST", "/drives/fan-1/parameters/write", {"values": {"F0.1": 1.0}, "save": True}),
    ("POST", "/drives/fan-1/waiver", {"reason": "because"}),
    ("POST", "/configuration/reload", {}),
    ("POST", "/drives/fan-1/set-frequency", {"frequency_hz": 10.0, "maximum_hz": 50.0}),
    ("POST", "/drives/fan-1/set-frequency", {"frequency_hz": 10.0, "scale": 10}),
    ("POST", "/drives/fan-1/set-frequency", {"frequency_hz": 10.0, "address": 2}),
    ("POST", "/drives/fan-1/set-frequency", {"frequency_hz": "10"}),
    ("POST", "/drives/fan-1/set-frequency", {"frequency_hz": True}),
    ("POST", "/drives/fan-1/set-frequency", {"frequency_hz": 1e308}),
    ("POST", "/drives/fan-1/set-frequency", {"frequency_hz": 50.5}),
    ("POST", "/drives/fan-1/set-frequency", {"frequency_hz": -1.0}),
    ("POST", "/drives/fan-1/set-frequency?frequency_hz=10", {}),
    ("POST", "/drives/fan-1/stop", {"how": "toggle"}),
]


def test_the_right_to_change_a_setpoint_changes_nothing_else(tmp_path: Path) -> None:
    async def scenario(kit: ServiceKit, harness: WebAppHarness) -> None:
        client = await harness.log_in("operator")
        assert (await client.post("/api/v1/drives/fan-1/lease")).status_code == 200
        frames = SentFrames(kit)
        await asyncio.sleep(5)
        polls = set(frames.sent)
        await client.post("/api/v1/drives/fan-1/lease/renew")
        for method, path, body in FIELDS:
            answer = await client.request(method, f"/api/v1{path}", json=body)
            assert answer.status_code in (403, 422), (path, body, answer.text)
        await asyncio.sleep(1)
        assert frames.sent == polls

    on_a_plant(tmp_path, scenario)


def test_the_lease_of_an_idle_session_stays_and_its_owner_can_only_stop(tmp_path: Path) -> None:
    async def scenario(kit: ServiceKit, harness: WebAppHarness) -> None:
        client = await harness.log_in("operator")
        assert (await started(client)).status_code == 200
        harness.clock.now += 900.0
        for _ in range(20):
            await asyncio.sleep(3)
            assert (await client.post("/api/v1/drives/fan-1/lease/renew")).status_code == 200
        answer = await client.post("/api/v1/drives/fan-1/set-frequency", json={"frequency_hz": 30.0})
        assert answer.json()["error"]["code"] == "auth.idle"
        assert kit.station("fan-1").motor.output_hz == pytest.approx(20.0)
        assert (await client.post("/api/v1/drives/fan-1/stop")).json()["outcome"]["status"] == "confirmed"

    on_a_plant(tmp_path, scenario)


def test_a_stop_voids_starts_armed_before_it_while_other_requests_wait(tmp_path: Path) -> None:
    """Reads wait for their turn; the first step of a start does not, else it would be newer than the stop."""

    async def scenario(kit: ServiceKit, harness: WebAppHarness) -> None:
        client = await harness.log_in("operator")
        assert (await client.post("/api/v1/drives/fan-1/lease")).status_code == 200
        questions = [client.get("/api/v1/buses") for _ in range(20)]
        steps = client.post("/api/v1/drives/fan-1/arm"), client.post("/api/v1/drives/fan-1/stop")
        *_, armed, _ = await asyncio.gather(*questions, *steps)
        body = {"frequency_hz": 20.0, "arm_token": armed.json().get("arm_token")}
        answer = await client.post("/api/v1/drives/fan-1/run", json=body)
        assert answer.json()["error"]["kind"] == "ArmRequired"
        assert kit.station("fan-1").motor.starts == 0

    on_a_plant(tmp_path, scenario)


def test_a_stop_of_everything_outlasts_a_release_requested_before_it(tmp_path: Path) -> None:
    async def scenario(kit: ServiceKit, harness: WebAppHarness) -> None:
        client = await harness.log_in("operator")
        assert (await client.post("/api/v1/drives/fan-1/lease")).status_code == 200
        questions = [client.get("/api/v1/buses") for _ in range(20)]
        await asyncio.gather(
            *questions, client.post("/api/v1/drives/fan-1/start-inhibit/release"), client.post("/api/v1/stop")
        )
        assert (await client.get("/api/v1/drives/fan-1")).json()["start_inhibited"]

    on_a_plant(tmp_path, scenario)
