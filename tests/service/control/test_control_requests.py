"""Requests for control: asked, handed over, declined, withdrawn, expired; no motor starts or stops by any of them."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace

import pytest

from drivebus.errors import ControlNotHeld, NotFound, PermissionDenied, ServiceError
from drivebus.service.auth.actor import local_actor
from drivebus.service.auth.rights import Role
from drivebus.service.config.model import OnClientLost
from drivebus.service.control.control_requests import (
    CONTROL_REQUEST_INTERVAL_S,
    CONTROL_REQUEST_TTL_S,
    ENDED_REQUEST_TTL_S,
    MAX_OPEN_REQUESTS,
    ControlRequests,
)
from drivebus.service.control.leases import LEASE_TTL_S, ControlLeases
from drivebus.testing.virtual_time import run
from drivebus.types import Json
from drivebus.values import Text, bilingual_text
from fixtures.service import DRIVES, ServiceKit, plant_config, remote_actor, running_service

ANN, BOB, CYD = remote_actor("ann"), remote_actor("bob"), remote_actor("cyd")
EVE = remote_actor("eve", Role.ENGINEER)
FAN = {"drive": "fan-1"}


def test_the_documented_times_and_limits() -> None:
    found = (CONTROL_REQUEST_TTL_S, CONTROL_REQUEST_INTERVAL_S, ENDED_REQUEST_TTL_S, MAX_OPEN_REQUESTS)
    assert found == (60, 30, 60, 20)


# --- alone ---------------------------------------------------------------------------------------------------------


def held_by_ann() -> ControlLeases:
    leases = ControlLeases()
    leases.take("a", ANN, 0.0)
    return leases


def test_a_second_user_and_a_user_in_haste_are_refused_with_the_time_to_wait() -> None:
    requests = ControlRequests()
    first = requests.make("r1", "a", BOB, None, 0.0)
    with pytest.raises(ServiceError) as busy:
        requests.make("r2", "a", CYD, None, 10.5)
    assert (busy.value.key, busy.value.params["wait_s"]) == ("plant.control_requested_already", 50)
    requests.end(first, "declined", 11.0, "ann")
    with pytest.raises(ServiceError) as hasty:
        requests.make("r3", "a", remote_actor("bob", session="another"), None, 29.5)
    assert (hasty.value.key, hasty.value.params["wait_s"]) == ("plant.control_request_too_soon", 1)
    assert requests.make("r4", "a", CYD, None, 12.0).is_open, "another user need not wait"
    requests.withdraw("a", CYD, 13.0)
    assert requests.make("r5", "a", BOB, None, CONTROL_REQUEST_INTERVAL_S).is_open


def test_a_user_has_at_most_twenty_open_requests() -> None:
    requests = ControlRequests()
    made = [requests.make(f"r{n}", f"d{n}", BOB, None, 0.0) for n in range(MAX_OPEN_REQUESTS)]
    with pytest.raises(ServiceError) as refused:
        requests.make("r", "d", BOB, None, 0.0)
    assert refused.value.key == "plant.control_requests_too_many"
    assert requests.make("r1", "d", BOB, None, 0.0).is_open, "requests of one selection of drives are one"
    requests.end(made[0], "declined", 1.0, "ann")
    assert requests.make("r", "e", BOB, None, 1.0).is_open


def test_a_request_expires_and_its_end_is_kept_for_a_minute() -> None:
    requests, leases = ControlRequests(), held_by_ann()
    requests.make("r1", "a", BOB, None, 0.0)
    for now in range(5, 60, 5):
        leases.renew("a", ANN, now)
        assert list(requests.expire(leases, now)) == []
    leases.renew("a", ANN, 59.0)
    assert [request.state for request in requests.expire(leases, CONTROL_REQUEST_TTL_S)] == ["expired"]
    assert list(requests.expire(leases, CONTROL_REQUEST_TTL_S + ENDED_REQUEST_TTL_S - 0.1)) == []
    assert requests.get("a") is not None and requests.find_open("a") is None
    assert list(requests.expire(leases, CONTROL_REQUEST_TTL_S + ENDED_REQUEST_TTL_S)) == []
    assert requests.get("a") is None


def test_a_request_ends_where_no_session_has_control_any_more_or_the_asking_one_took_it() -> None:
    requests, leases = ControlRequests(), held_by_ann()
    requests.make("r1", "a", BOB, None, 0.0)
    leases.release("a", ANN, 1.0)
    assert [request.state for request in requests.expire(leases, 1.0)] == ["released"]
    leases.take("b", ANN, 0.0)
    requests.make("r2", "b", EVE, None, 0.0)
    leases.take("b", EVE, 1.0)
    assert [request.state for request in requests.expire(leases, 1.0)] == ["withdrawn"]


def test_only_the_session_that_has_control_hands_it_over() -> None:
    leases = held_by_ann()
    for other in (BOB, EVE, remote_actor("ann", session="another")):
        with pytest.raises(ControlNotHeld):
            leases.hand_over("a", other, CYD, 1.0)
    leases.hand_over("a", ANN, BOB, 1.0)
    lease = leases.get("a", 1.0)
    assert lease is not None and (lease.actor, lease.expires_at, lease.claimed) == (BOB, 1.0 + LEASE_TTL_S, False)
    with pytest.raises(ControlNotHeld):
        leases.hand_over("a", ANN, CYD, 1.0 + LEASE_TTL_S)


def test_the_same_user_answers_from_a_second_terminal_on_the_local_socket_and_nothing_else() -> None:
    """Each local command has a session of its own; a remote session of the same name is another holder."""
    leases = ControlLeases()
    first, second = local_actor("ann", "cli-1"), local_actor("ann", "cli-2")
    leases.take("a", first, 0.0)
    for other in (local_actor("root", "cli-3"), ANN):
        with pytest.raises(ControlNotHeld):
            leases.require_answerable("a", other, 1.0)
    with pytest.raises(ControlNotHeld):
        leases.require("a", second, 1.0)  # it answers, but commands nothing
    assert leases.require_answerable("a", second, 1.0) is leases.get("a", 1.0) is not None
    leases.hand_over("a", second, BOB, 1.0)
    with pytest.raises(ControlNotHeld):
        leases.require_answerable("a", second, 1.0)
    with pytest.raises(ControlNotHeld):
        held_by_ann().hand_over("a", second, BOB, 1.0)


@pytest.mark.parametrize("use", ["require", "renew", "take"])
def test_control_that_was_handed_over_is_lost_like_any_other_once_it_was_used(use: str) -> None:
    leases = held_by_ann()
    leases.hand_over("a", ANN, BOB, 1.0)
    getattr(leases, use)("a", BOB, 2.0)
    (lost,) = leases.pop_expired(30.0)
    assert lost.claimed


# --- in a service ----------------------------------------------------------------------------------------------------


def played(scenario: Callable[[ServiceKit], Awaitable[None]], policy: OnClientLost = OnClientLost.STOP) -> None:
    """Run a scenario in which ann controls fan-1, which she has started."""

    async def play() -> None:
        drives = tuple(replace(drive, on_client_lost=policy) for drive in DRIVES)
        async with running_service(plant_config(drives=drives)) as kit:
            await asyncio.sleep(2)
            await kit.grant_waivers()
            await kit.call("lease.take", ANN, **FAN)
            token = (await kit.call("drive.arm", ANN, **FAN))["arm_token"]
            await kit.call("drive.run", ANN, **FAN, frequency_hz=20.0, arm_token=token)
            await asyncio.sleep(5)
            await kit.call("lease.renew", ANN, **FAN)
            motor = kit.station("fan-1").motor
            starts, stops = motor.starts, kit.service.plant.stop_statistics.requested
            await scenario(kit)
            assert (motor.starts, kit.service.plant.stop_statistics.requested) == (starts, stops), "a motor was moved"

    run(play())


async def shown(kit: ServiceKit) -> Json:
    found: Json = (await kit.call("drives.get", **FAN))["control_request"]
    return found


def events(kit: ServiceKit) -> list[str]:
    return [event["text"]["en"] for event in kit.history.events if event["kind"] == "lease"]


def test_the_holder_sees_who_asks_and_why_and_hands_over_a_running_drive() -> None:
    async def scenario(kit: ServiceKit) -> None:
        await kit.call("control_request.make", BOB, **FAN, reason="belt is slipping")
        request = (await kit.call("lease.renew", ANN, **FAN))["control_request"]
        assert (request["user"], request["reason"], request["state"]) == ("bob", "belt is slipping", "open")
        assert request["expires_ms"] - request["requested_ms"] == 60_000 and request == await shown(kit)
        await kit.call("control_request.grant", ANN, **FAN, request=request["id"])
        view = await kit.call("drives.get", **FAN)
        assert (view["lease"]["session"], view["state"]) == (BOB.session, "running")
        assert (view["control_request"]["state"], view["control_request"]["answered_by"]) == ("granted", "ann")
        with pytest.raises(ControlNotHeld):
            await kit.call("drive.set_frequency", ANN, **FAN, frequency_hz=25.0)
        await kit.call("drive.set_frequency", BOB, **FAN, frequency_hz=25.0)
        assert events(kit) == ["asks ann for control: belt is slipping", "control was handed over to bob"]

    played(scenario)


def test_each_step_is_in_the_audit_trail_with_its_user() -> None:
    async def scenario(kit: ServiceKit) -> None:
        await kit.call("control_request.make", BOB, **FAN)
        await kit.call("control_request.decline", ANN, **FAN, request=(await shown(kit))["id"])
        await kit.call("control_request.make", CYD, **FAN)
        await kit.call("control_request.withdraw", CYD, **FAN)
        made = [(entry.who, entry.what, entry.target) for entry in kit.trail.entries if entry.outcome == "done"]
        assert made[-4:] == [
            (user, f"control_request.{what}", "fan-1")
            for user, what in (("bob", "make"), ("ann", "decline"), ("cyd", "make"), ("cyd", "withdraw"))
        ]

    played(scenario)


def test_a_request_for_a_selection_has_one_id_an_outcome_for_each_drive_and_is_withdrawn_at_once() -> None:
    async def scenario(kit: ServiceKit) -> None:
        await kit.call("lease.take", CYD, drive="pump-1")
        found = await kit.call("control_requests.make", CYD, drives=["fan-1", "fan-2", "pump-1"], reason="belt check")
        outcomes = {id: outcome.get("status", outcome.get("code")) for id, outcome in found["outcomes"].items()}
        assert outcomes == {"fan-1": "done", "fan-2": "plant.control_is_free", "pump-1": "unchanged"}
        await kit.call("lease.renew", ANN, **FAN)
        asked = await kit.call("control_requests.make", BOB, drives=["fan-1", "pump-1"])
        assert asked["outcomes"]["fan-1"]["code"] == "plant.control_requested_already"
        await kit.call("control_requests.withdraw", BOB, all=True)
        assert (await shown(kit))["state"] == "open", "the request of another session was withdrawn"
        found = (await kit.call("control_requests.withdraw", CYD, all=True))["outcomes"]
        assert [id for id, outcome in found.items() if outcome["status"] == "done"] == ["fan-1"]
        assert (await shown(kit))["state"] == "withdrawn"
        await kit.call("lease.take", ANN, drive="fan-2")
        await kit.call("control_requests.make", EVE, drives=["fan-1", "fan-2"])
        ids = {(await kit.call("drives.get", drive=drive))["control_request"]["id"] for drive in ("fan-1", "fan-2")}
        assert len(ids) == 1, "the requests of one selection have no common id"

    played(scenario)


def test_a_declined_request_leaves_control_where_it_was_and_is_shown_as_declined() -> None:
    async def scenario(kit: ServiceKit) -> None:
        await kit.call("control_request.make", BOB, **FAN)
        await kit.call("control_request.decline", ANN, **FAN, request=(await shown(kit))["id"])
        view = await kit.call("drives.get", **FAN)
        assert view["lease"]["owner"] == "ann"
        assert (view["control_request"]["state"], view["control_request"]["answered_by"]) == ("declined", "ann")

    played(scenario)


def test_only_the_holder_answers_and_only_the_request_that_was_shown() -> None:
    async def scenario(kit: ServiceKit) -> None:
        await kit.call("control_request.make", BOB, **FAN)
        id = (await shown(kit))["id"]
        for other in (BOB, CYD, EVE):
            for answer in ("grant", "decline"):
                with pytest.raises(ControlNotHeld):
                    await kit.call(f"control_request.{answer}", other, **FAN, request=id)
        with pytest.raises(NotFound):
            await kit.call("control_request.withdraw", CYD, **FAN)
        await kit.call("control_request.withdraw", BOB, **FAN)
        await kit.call("control_request.make", CYD, **FAN)
        with pytest.raises(NotFound):
            await kit.call("control_request.grant", ANN, **FAN, request=id)
        assert (await kit.call("drives.get", **FAN))["lease"]["owner"] == "ann", "cyd got what was granted to bob"

    played(scenario)


def test_only_a_user_with_the_right_to_take_control_asks_and_only_for_what_another_session_has() -> None:
    async def scenario(kit: ServiceKit) -> None:
        with pytest.raises(PermissionDenied):
            await kit.call("control_request.make", remote_actor("vic", Role.VIEWER), **FAN)
        for drive, actor, key in (("fan-1", ANN, "plant.control_is_own"), ("fan-2", BOB, "plant.control_is_free")):
            with pytest.raises(ServiceError) as refused:
                await kit.call("control_request.make", actor, drive=drive)
            assert refused.value.key == key

    played(scenario)


def test_a_takeover_stays_possible_and_names_the_request_which_the_new_holder_then_has() -> None:
    async def scenario(kit: ServiceKit) -> None:
        await kit.call("control_request.make", BOB, **FAN)
        found = await kit.call("lease.take", EVE, **FAN)
        assert found["lease"]["owner"] == "eve" and found["control_request"]["user"] == "bob"
        assert events(kit)[-1] == "the control lease was taken from ann, whom bob had asked for control"
        await kit.call("control_request.grant", EVE, **FAN, request=found["control_request"]["id"])
        assert (await kit.call("drives.get", **FAN))["lease"]["owner"] == "bob"

    played(scenario)


def test_control_that_was_handed_over_to_a_session_that_is_gone_counts_as_released_and_raises_an_alarm() -> None:
    """A drive that stops when its client is lost is not stopped: its holder has released it."""

    async def scenario(kit: ServiceKit) -> None:
        await kit.call("control_request.make", BOB, **FAN)
        await kit.call("control_request.grant", ANN, **FAN, request=(await shown(kit))["id"])
        await asyncio.sleep(LEASE_TTL_S + 1)
        view = await kit.call("drives.get", **FAN)
        assert (view["lease"], view["state"]) == (None, "running")
        assert "bob did not use the control that was handed over: no session has control" in events(kit)
        (alarm,) = [alarm for alarm in kit.service.plant.alarms.active() if alarm.kind == "control_lost"]
        text = "Fan 1 runs, and bob did not use the control that was handed over: no session has control"
        assert (alarm.title.en, alarm.text.en) == ("Control not taken over", text), "control was handed over, not lost"
        assert alarm.text.zh == "风机 1 正在运行，而 bob 未使用移交来的控制权：当前没有会话控制"
        motion = bilingual_text("alarms.motion.running")
        drive = Text("Fan 1", "风机 1")
        assert alarm.text == bilingual_text("alarms.text.control_not_taken", drive=drive, motion=motion, owner="bob")

    played(scenario)


def test_a_request_without_an_answer_expires_after_a_minute_with_an_event() -> None:
    async def scenario(kit: ServiceKit) -> None:
        await kit.call("control_request.make", BOB, **FAN)
        for _ in range(13):
            await asyncio.sleep(4.7)
            await kit.call("lease.renew", ANN, **FAN)
        assert (await shown(kit))["state"] == "expired"
        assert events(kit)[-1] == "the request of bob for control was not answered in time"

    played(scenario)


def test_a_request_is_published_to_live_clients_within_a_cycle() -> None:
    async def scenario(kit: ServiceKit) -> None:
        await kit.call("control_request.make", BOB, **FAN)
        await asyncio.sleep(0.3)
        assert kit.service.plant.hub.topics["drives/fan-1"]["control_request"]["user"] == "bob"

    played(scenario)


def test_a_takeover_by_the_asking_user_itself_names_no_other_request() -> None:
    async def scenario(kit: ServiceKit) -> None:
        await kit.call("control_request.make", EVE, **FAN)
        await kit.call("lease.take", EVE, **FAN)
        assert events(kit)[-1] == "the control lease was taken from ann"

    played(scenario)


def test_the_request_for_a_drive_that_a_reload_removed_is_dropped() -> None:
    async def scenario(kit: ServiceKit) -> None:
        await kit.call("control_request.make", BOB, **FAN)
        kit.service.plant.remove_drive("fan-1")
        assert kit.service.plant.control_requests.get("fan-1") is None

    played(scenario)
