"""Communication-loss tests: played whole on simulated drives; a drive that stopped by itself needs no waiver."""

from __future__ import annotations

import asyncio
import json
import re
from contextlib import suppress
from dataclasses import replace
from typing import Any

import pytest

from drivebus import i18n, profiles
from drivebus.drives import MemoryStore
from drivebus.drives.dialects.base import UNNAMED_FAULT_CODE, reported_fault
from drivebus.drives.state import DerivedState, DriveState
from drivebus.errors import AuditUnavailable, ControlNotHeld, DrivebusError, ServiceError, Superseded, WaiverRequired
from drivebus.service.auth.rights import Role
from drivebus.service.config.model import BusConfig, DriveConfig, PlantConfig
from drivebus.service.control.comm_loss_record import CommLossRecord
from drivebus.service.control.comm_loss_test import _short_name
from drivebus.testing.virtual_time import run
from drivebus.types import Json
from drivebus.values import Text, bilingual_text
from fixtures.service import BUSES, DRIVES, ServiceKit, plant_config, remote_actor, running_service

ENGINEER = remote_actor("eve", Role.ENGINEER)
OTHER_MODEL: PlantConfig = plant_config(drives=(replace(DRIVES[0], model="c300"), *DRIVES[1:]))
TRIP, STOP = 2, 1  # actions of the simulated C320; its manual publishes none
TIME, ACTION = 0x9_04, 0x9_03


def set_keypad(kit: ServiceKit, action: int, time_s: float) -> None:
    kit.station("fan-1").keypad_set(ACTION, action)
    kit.station("fan-1").keypad_set(TIME, round(time_s * 10))


async def begin(kit: ServiceKit, **params: Any) -> Json:
    """Take control, arm and start a test as the page does; a task of the test's own renews the lease."""
    await kit.call("lease.take", ENGINEER, drive="fan-1")
    armed = await kit.call("drive.arm", ENGINEER, drive="fan-1", purpose="comm_loss_test")
    params = {"drive": "fan-1", "frequency_hz": 10.0, "arm_token": armed["arm_token"]} | params
    return await kit.call("comm_loss.test", ENGINEER, **params)


async def wait_for_silence(kit: ServiceKit) -> None:
    while ((await comm_loss(kit))["test"] or {}).get("phase") != "silent":
        await asyncio.sleep(0.5)
        await kit.call("lease.renew", ENGINEER, drive="fan-1")


async def wait_for_end(kit: ServiceKit, limit_s: float = 300.0) -> None:
    for _ in range(round(limit_s)):
        await asyncio.sleep(1)
        if (await comm_loss(kit))["test"] is None:
            break
        with suppress(ControlNotHeld):
            await kit.call("lease.renew", ENGINEER, drive="fan-1")
    await kit.call("lease.release", ENGINEER, drive="fan-1")


async def run_comm_loss_test(kit: ServiceKit, **params: Any) -> None:
    await begin(kit, **params)
    await wait_for_end(kit)


async def comm_loss(kit: ServiceKit) -> Json:
    found: Json = (await kit.call("drives.get", drive="fan-1"))["comm_loss"]
    return found


def has_sentence(kit: ServiceKit, key: str, found: Json) -> bool:
    """Return whether the newest event and the view of the fan state its test by this sentence."""
    record = kit.service.plant.drives["fan-1"].comm_loss.record
    assert record is not None
    sentence = i18n.text(key, **record.message_params)
    return kit.event_texts("waiver")[-1] == sentence == found["text"]["en"]


async def start(kit: ServiceKit) -> None:
    await kit.call("drive.run", drive="fan-1", frequency_hz=20.0)


def test_a_drive_that_trips_in_the_silence_needs_no_waiver() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            set_keypad(kit, TRIP, 5.0)
            await asyncio.sleep(8)
            set_keypad(kit, TRIP, 4.0)
            with pytest.raises(WaiverRequired):
                await start(kit)
            answer = await begin(kit)
            assert answer["outcome"]["status"] == "confirmed" and answer["silence_s"] == 18.0
            assert kit.station("fan-1").motor.energised
            await wait_for_end(kit)
            found = await comm_loss(kit)
            assert (found["kind"], found["after_s"]) == ("trips", 19.0), "18 s, and the time of the next reply"
            assert found["tested"]["result"] == "trips" and found["tested"]["holds"]
            assert found["tested"]["parameters"] == {"F9.3": TRIP, "F9.4": 40}, "read again before the test"
            assert found["tested"]["user"] == "eve" and has_sentence(kit, "plant.comm_loss_tested_trips", found)
            assert "试验" in found["text"]["zh"] and found["tested"]["fault"] in found["text"]["en"]
            await kit.call("drive.reset", drive="fan-1")
            await start(kit)
            entry = next(entry for entry in kit.trail.entries if entry.what == "comm_loss.result")
            assert entry.who == "eve" and entry.target == "fan-1" and entry.outcome == "trips"
            assert kit.trail.outcomes("comm_loss.test") == ["requested", "confirmed"]

    run(scenario())


def test_a_trip_is_recorded_by_its_code_where_the_keypad_shows_no_label() -> None:
    vc660, c320 = profiles.load("vc660"), profiles.load("c320")
    found = [reported_fault(vc660, DerivedState(DriveState.FAULT, None, code)) for code in (17, UNNAMED_FAULT_CODE)]
    found += [reported_fault(c320, DerivedState(DriveState.FAULT, None, 17)), None]
    assert [_short_name(fault) for fault in found] == ["17", "", "Fu.17", None]


def test_a_drive_that_keeps_running_is_stopped_and_still_needs_a_waiver() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(4)
            await run_comm_loss_test(kit, silence_s=20.0)
            found = await comm_loss(kit)
            assert found["kind"] == "runs_on" and found["tested"]["result"] == "runs_on"
            assert not kit.station("fan-1").motor.energised, "the test stops the drive at its end"
            after_s = int(re.search(r"still ran after (\d+) s", found["text"]["en"])[1])  # type: ignore[index]
            assert after_s <= found["tested"]["silence_s"] < after_s + 1, "it says no longer time than was seen"
            assert has_sentence(kit, "plant.comm_loss_tested_runs_on", found)
            with pytest.raises(WaiverRequired) as blocked:
                await start(kit)
            assert blocked.value.key == "plant.waiver_needed_tested", "it was tested: another test alone helps nobody"
            await kit.grant_waivers("fan-1")
            await start(kit)

    run(scenario())


def test_a_tested_stop_without_a_fault_counts_and_a_drive_that_the_profile_trusts_but_ran_on_does_not() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            set_keypad(kit, STOP, 3.0)
            await asyncio.sleep(8)
            await run_comm_loss_test(kit)
            found = await comm_loss(kit)
            assert found["tested"]["result"] == "stops" and has_sentence(kit, "plant.comm_loss_tested_stops", found)
            dialect = kit.service.plant.drives["fan-1"].drive.dialect
            rule = replace(dialect.profile.comm_loss, trips_values=(0,))
            dialect.profile = replace(dialect.profile, comm_loss=rule)
            set_keypad(kit, 0, 3.0)
            kit.service.plant.drives["fan-1"].comm_loss.invalidate()
            await asyncio.sleep(5)
            assert (await comm_loss(kit))["kind"] == "trips", "as the profile says"
            await run_comm_loss_test(kit)
            assert (await comm_loss(kit))["kind"] == "runs_on", "as the test showed"
            with pytest.raises(WaiverRequired):
                await start(kit)

    run(scenario())


def test_an_adapter_that_is_pulled_for_longer_than_the_silence_is_measured_until_the_next_reply() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            set_keypad(kit, TRIP, 5.0)
            await asyncio.sleep(8)
            await begin(kit, silence_s=6.0)
            await wait_for_silence(kit)
            adapter = kit.simulated_bus("fan-1")
            adapter.unplug()
            for _ in range(20):
                await asyncio.sleep(1)
                await kit.call("lease.renew", ENGINEER, drive="fan-1")
            adapter.replug()
            await wait_for_end(kit)
            found = (await comm_loss(kit))["tested"]
            assert found["result"] == "trips" and 19.0 < found["silence_s"] < 30.0

    run(scenario())


def test_the_user_who_saw_the_motor_stop_ends_the_silence() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            set_keypad(kit, TRIP, 5.0)
            await asyncio.sleep(8)
            with pytest.raises(ServiceError) as none:
                await kit.call("comm_loss.test_read", drive="fan-1")
            assert none.value.key == "plant.comm_loss_no_test"
            await begin(kit, silence_s=100.0)
            while kit.station("fan-1").motor.energised or (await comm_loss(kit))["test"]["phase"] != "silent":
                await asyncio.sleep(0.5)
                await kit.call("lease.renew", ENGINEER, drive="fan-1")
            await kit.call("comm_loss.test_read", ENGINEER, drive="fan-1")
            await wait_for_end(kit)
            found = await comm_loss(kit)
            assert found["kind"] == "trips" and found["after_s"] in (6.0, 7.0)

    run(scenario())


@pytest.mark.parametrize("what", ["read", "stop", "stop_all", "lease", "early"])
def test_a_test_that_was_disturbed_records_nothing_and_stops_the_drive(what: str) -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            set_keypad(kit, TRIP, 60.0)
            await asyncio.sleep(8)
            await begin(kit, silence_s=30.0)
            await wait_for_silence(kit)
            await asyncio.sleep(3)
            if what == "read":
                await kit.call("parameters.read", drive="fan-1", names=["F0.1"])
            elif what == "stop":
                await kit.call("drive.stop", drive="fan-1")
            elif what == "stop_all":
                await kit.call("plant.stop")
            elif what == "early":
                await kit.call("comm_loss.test_read", ENGINEER, drive="fan-1")
            await asyncio.sleep(15)
            found = await comm_loss(kit)
            assert found["tested"] is None and found["test"] is None and found["kind"] == "unknown"
            (void,) = [
                text
                for text in kit.event_texts("waiver")
                if text.startswith("no result of the communication-loss test")
            ]
            assert ("still ran after" in void and "the silence ended early" in void) is (what in ("read", "early"))
            assert not kit.station("fan-1").motor.energised
            assert (await kit.call("drives.get", drive="fan-1"))["state"] == "stopped", "it is polled again"

    run(scenario())


@pytest.mark.parametrize("gone_s", [None, 100.0, 150.0])
def test_a_drive_is_called_unanswering_after_the_silence_only_at_the_end_of_the_time_to_plug_in_again(
    gone_s: float | None,
) -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            set_keypad(kit, TRIP, 3.0)
            await asyncio.sleep(8)
            await begin(kit, silence_s=6.0)
            await wait_for_silence(kit)
            adapter = kit.simulated_bus("fan-1")
            if gone_s is not None:
                adapter.unplug()
                for _ in range(round(gone_s)):
                    await asyncio.sleep(1)
                    with suppress(ControlNotHeld):
                        await kit.call("lease.renew", ENGINEER, drive="fan-1")
                adapter.replug()
            await wait_for_end(kit)
            why = i18n.text("plant.comm_loss_no_reply", "en", drive="fan-1", seconds=120.0)
            assert [why in text for text in kit.event_texts("waiver")] == [gone_s == 150.0]
            assert ((await comm_loss(kit))["tested"] is None) is (gone_s == 150.0)

    run(scenario())


def test_a_drive_that_only_accelerates_is_not_tested() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            set_keypad(kit, TRIP, 5.0)
            kit.station("fan-1").set_ramps(600.0, 1.0)
            await asyncio.sleep(8)
            await run_comm_loss_test(kit)
            why = i18n.text("plant.comm_loss_not_turning", "en", drive="fan-1")
            found = await comm_loss(kit)
            assert [why in text for text in kit.event_texts("waiver")] == [True] and found["tested"] is None
            assert why in found["no_result"]["en"]
            kit.station("fan-1").set_ramps(1.0, 1.0)
            await run_comm_loss_test(kit)
            assert (await comm_loss(kit))["no_result"] is None
            assert [why in text for text in kit.event_texts("waiver")] == [True, False]

    run(scenario())


def test_a_drive_that_stops_while_it_is_polled_ends_the_test_with_this_reason() -> None:
    """Its time is shorter than the interval of the polls: 2 is 0.2 s where the unit is a tenth of a second."""

    async def scenario() -> None:
        async with running_service() as kit:
            set_keypad(kit, STOP, 0.1)
            await asyncio.sleep(8)
            begun_at = kit.service.plant.now()
            await run_comm_loss_test(kit)
            why = i18n.text("plant.comm_loss_off_before", "en", drive="fan-1")
            assert [why in text for text in kit.event_texts("waiver")] == [True] and (await comm_loss(kit))[
                "tested"
            ] is None
            assert kit.service.plant.now() - begun_at < 30.0
            set_keypad(kit, STOP, 3.0)
            await run_comm_loss_test(kit)
            assert [why in text for text in kit.event_texts("waiver")] == [True, False]

    run(scenario())


def test_a_test_needs_parameters_that_can_be_read_and_a_model_that_reports_whether_it_runs() -> None:
    async def scenario() -> None:
        saw = DriveConfig(id="saw", bus="c", address=1, model="df800", title=Text("Saw", "锯"))
        config = plant_config(buses=(*BUSES, BusConfig("c", "sim://df800@1")), drives=(*DRIVES, saw))
        async with running_service(config) as kit:
            cells = kit.station("fan-1").memory.specs
            hidden = cells.pop(TIME)
            await asyncio.sleep(8)
            with pytest.raises(ServiceError) as unread:
                await begin(kit)
            assert unread.value.key == "plant.comm_loss_parameters_not_read"
            cells[TIME] = hidden
            await begin(kit)
            with pytest.raises(ServiceError) as stateless:
                await kit.call("comm_loss.test", drive="saw", frequency_hz=10.0)
            assert stateless.value.key == "plant.comm_loss_no_state"

    run(scenario())


def test_a_changed_parameter_voids_the_test_until_it_reads_as_before() -> None:
    async def change(kit: ServiceKit, tenths: float) -> None:
        await kit.call("lease.take", ENGINEER, drive="fan-1")
        await kit.call("parameters.write", ENGINEER, drive="fan-1", values={"F9.4": tenths})
        assert (await comm_loss(kit))["kind"] == "unknown", "until it is read"
        await asyncio.sleep(5)
        await kit.call("lease.release", ENGINEER, drive="fan-1")

    async def scenario() -> None:
        async with running_service() as kit:
            set_keypad(kit, TRIP, 5.0)
            await asyncio.sleep(8)
            await run_comm_loss_test(kit)
            await kit.call("drive.reset", drive="fan-1")
            await change(kit, 100.0)
            found = await comm_loss(kit)
            assert not found["tested"]["holds"] and found["kind"] == "unknown"
            with pytest.raises(WaiverRequired) as blocked:
                await start(kit)
            runtime = kit.service.plant.drives["fan-1"]
            params = {"why": runtime.comm_loss.view.text} | runtime.comm_loss.record.message_params  # type: ignore[union-attr]
            assert blocked.value.params["why"] == bilingual_text("plant.comm_loss_test_outdated", **params)
            await change(kit, 50.0)
            await start(kit)

    run(scenario())


def test_a_record_survives_a_restart_and_is_ignored_for_another_drive_of_its_name() -> None:
    async def scenario() -> None:
        store = MemoryStore()
        async with running_service(store=store) as kit:
            set_keypad(kit, TRIP, 5.0)
            await asyncio.sleep(8)
            await run_comm_loss_test(kit)
        async with running_service(store=store) as kit:
            set_keypad(kit, TRIP, 5.0)
            await asyncio.sleep(8)
            await start(kit)
        async with running_service(OTHER_MODEL, store=store) as kit:
            assert any("made on another drive" in text and BUSES[0].port in text for text in kit.event_texts("waiver"))
            assert (await comm_loss(kit))["tested"] is None
        async with running_service(store=store) as kit:
            set_keypad(kit, TRIP, 5.0)
            await asyncio.sleep(8)
            assert kit.drives_of_events("plant.comm_loss_discarded") == []
            await kit.call("comm_loss.discard", ENGINEER, drive="fan-1")
            assert kit.drives_of_events("plant.comm_loss_discarded") == ["fan-1"]
            with pytest.raises(WaiverRequired):
                await start(kit)
        assert store.get("comm-loss/fan-1") == ""

    run(scenario())


def test_a_result_that_can_not_be_written_into_the_audit_trail_counts_for_nothing() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            set_keypad(kit, TRIP, 5.0)
            await asyncio.sleep(8)
            await begin(kit)
            kit.trail.broken = True
            await wait_for_end(kit)
            kit.trail.broken = False
            assert (await comm_loss(kit))["tested"] is None and kit.store.get("comm-loss/fan-1") is None
            assert AuditUnavailable("plant.audit_unavailable").text("en") in kit.event_texts("waiver")[-1]

    run(scenario())


def test_a_test_needs_control_its_own_token_a_drive_at_rest_and_the_right_to_set_limits() -> None:
    async def refused(kit: ServiceKit, **params: Any) -> str:
        with pytest.raises(DrivebusError) as error:
            await kit.call("comm_loss.test", ENGINEER, **({"drive": "fan-1", "frequency_hz": 10.0} | params))
        return error.value.key

    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(4)
            assert await refused(kit) == "plant.no_lease"
            await kit.call("lease.take", ENGINEER, drive="fan-1")
            assert await refused(kit) == "plant.arm_needed"
            with pytest.raises(WaiverRequired):
                await kit.call("drive.arm", ENGINEER, drive="fan-1")
            await kit.grant_waivers()
            started = await kit.call("drive.arm", ENGINEER, drive="fan-1")
            assert await refused(kit, arm_token=started["arm_token"]) == "plant.arm_void"
            tested = await kit.call("drive.arm", ENGINEER, drive="fan-1", purpose="comm_loss_test")
            with pytest.raises(DrivebusError, match="ended by a stop"):
                await kit.call("drive.run", ENGINEER, drive="fan-1", frequency_hz=10.0, arm_token=tested["arm_token"])
            assert kit.station("fan-1").motor.starts == 0
            await kit.call("lease.take", drive="fan-2")
            await kit.call("drive.run", drive="fan-2", frequency_hz=10.0)
            await asyncio.sleep(2)
            with pytest.raises(ServiceError) as turning:
                await kit.call("comm_loss.test", drive="fan-2", frequency_hz=10.0)
            assert turning.value.key == "plant.comm_loss_not_at_rest"
            with pytest.raises(DrivebusError) as denied:
                await kit.call("comm_loss.test", remote_actor("ann"), drive="fan-1", frequency_hz=10.0)
            assert denied.value.key == "plant.forbidden"

    run(scenario())


@pytest.mark.parametrize(
    "changed",
    [{"parameters": {"F9.4": "50"}}, {"silence_s": None}, {"result": "never"}, {"more": 1}, {"time_ms": 10**18}],
)
def test_a_damaged_record_is_none(changed: Json) -> None:
    whole: Json = {
        "result": "trips", "silence_s": 5.0, "time_ms": 1, "user": "eve", "model": "c320", "port": BUSES[0].port,
        "address": 1, "parameters": {"F9.3": TRIP, "F9.4": 50}, "fault": None,
    }  # fmt: skip
    assert CommLossRecord.from_json(json.dumps(whole)) is not None

    async def scenario() -> None:
        store = MemoryStore()
        store.put("comm-loss/fan-1", json.dumps(whole | changed))
        async with running_service(store=store) as kit:
            assert (await comm_loss(kit))["tested"] is None

    run(scenario())


def test_a_stop_while_the_parameters_are_read_before_the_test_prevents_its_start() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(4)
            test = asyncio.create_task(kit.call("comm_loss.test", drive="fan-1", frequency_hz=10.0))
            await asyncio.sleep(0.02)
            again = asyncio.create_task(kit.call("comm_loss.test", drive="fan-1", frequency_hz=10.0))
            await asyncio.sleep(0.001)
            assert (await comm_loss(kit))["test"]["phase"] == "starting"
            await kit.call("drive.stop", drive="fan-1")
            with pytest.raises(Superseded):
                await test
            with pytest.raises(ServiceError) as second:
                await again
            assert second.value.key == "plant.comm_loss_testing"
            assert kit.station("fan-1").motor.starts == 0 and (await comm_loss(kit))["test"] is None

    run(scenario())
