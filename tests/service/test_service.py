"""The service as a whole: views, rights, audit records."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from drivebus import profiles
from drivebus.drives.operations import parameters
from drivebus.drives.outcome import OutcomeStatus
from drivebus.drives.state import DriveState
from drivebus.errors import (
    ArmRequired,
    CapabilityError,
    ControlNotHeld,
    InvalidParameters,
    NotFound,
    PermissionDenied,
    TargetNotReached,
    WaiverRequired,
)
from drivebus.service.auth.actor import Actor
from drivebus.service.auth.rights import Right, Role
from drivebus.testing.virtual_time import run
from fixtures.service import LOCAL, FakeAuditTrail, ServiceKit, remote_actor, running_service


def test_every_drive_is_online_within_seconds() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(5)
            found = (await kit.call("drives.list"))["drives"]
            assert [view["presence"] for view in found] == ["online"] * 4
            assert [view["state"] for view in found] == ["stopped"] * 4
            assert found[0]["signals"]["output_frequency"]["quality"] == "good"

    run(scenario())


def test_a_trail_that_was_cut_a_replaced_key_and_a_missing_head_are_alarms_at_the_start() -> None:
    async def scenario() -> None:
        async with running_service(
            trail=FakeAuditTrail(records_missing=True, key_replaced=True, head_missing=True)
        ) as kit:
            found = {alarm.kind: alarm.text.en for alarm in kit.service.plant.alarms.active()}
            assert "records or checkpoints were missing" in found["audit_incomplete"]
            assert "another key" in found["audit_key_replaced"]
            assert "nonexistent.audit.head was missing" in found["audit_head_missing"]
        async with running_service() as kit:
            assert not {"audit_incomplete", "audit_key_replaced", "audit_head_missing"} & {
                alarm.kind for alarm in kit.service.plant.alarms.active()
            }

    run(scenario())


def test_a_local_start_is_confirmed_and_recorded_before_and_after() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(5)
            await kit.grant_waivers("fan-1")
            found = await kit.call("drive.run", drive="fan-1", frequency_hz=20.0)
            assert found["outcome"]["status"] == "confirmed"
            assert kit.trail.outcomes("drive.run") == ["requested", "confirmed"]
            stopped = await kit.call("drive.stop", drive="fan-1")
            assert stopped["outcome"]["status"] == "confirmed"
            assert kit.trail.outcomes("drive.stop") == ["requested", "confirmed"]

    run(scenario())


def test_a_remote_start_needs_a_lease_and_an_arm_token_that_is_valid_once() -> None:
    """A replayed request starts nothing."""

    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(5)
            await kit.grant_waivers()
            ann = remote_actor()
            with pytest.raises(ControlNotHeld):
                await kit.call("drive.arm", ann, drive="fan-1")
            await kit.call("lease.take", ann, drive="fan-1")
            with pytest.raises(ArmRequired):
                await kit.call("drive.run", ann, drive="fan-1", frequency_hz=20.0)
            arm = (await kit.call("drive.arm", ann, drive="fan-1"))["arm_token"]
            await kit.call("drive.run", ann, drive="fan-1", frequency_hz=20.0, arm_token=arm)
            with pytest.raises(ArmRequired) as rejected:
                await kit.call("drive.run", ann, drive="fan-1", frequency_hz=25.0, arm_token=arm)
            assert rejected.value.key == "plant.arm_void", "also before a stop revokes it"
            await kit.call("lease.renew", ann, drive="fan-1")
            await kit.call("drive.stop", ann, drive="fan-1")
            await kit.call("lease.take", ann, drive="fan-1")
            with pytest.raises(ArmRequired):
                await kit.call("drive.run", ann, drive="fan-1", frequency_hz=20.0, arm_token=arm)
            assert kit.service.plant.drives["fan-1"].status().state is not DriveState.RUNNING

    run(scenario())


def test_a_drive_that_may_run_on_after_a_communication_loss_needs_a_waiver() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(5)
            with pytest.raises(WaiverRequired):
                await kit.call("drive.run", drive="pump-1", frequency_hz=20.0)
            view = await kit.call("drives.get", drive="pump-1")
            assert "plant.waiver_needed" in [blocker["key"] for blocker in view["start_blockers"]]
            await kit.grant_waivers("pump-1")
            assert (await kit.call("drive.run", drive="pump-1", frequency_hz=20.0))["outcome"]["status"] == "confirmed"

    run(scenario())


@pytest.mark.parametrize(
    ("operation", "role", "params"),
    [
        ("drive.run", Role.VIEWER, {"drive": "fan-1", "frequency_hz": 20.0}),
        ("drive.stop", Role.VIEWER, {"drive": "fan-1"}),
        ("drive.limits", Role.OPERATOR, {"drive": "fan-1"}),
        ("parameters.write", Role.OPERATOR, {"drive": "fan-1", "values": {"F0.1": 2.0}}),
    ],
)
def test_the_service_itself_rejects_an_operation_without_its_right(
    operation: str, role: Role, params: dict[str, Any]
) -> None:

    async def scenario() -> None:
        async with running_service() as kit:
            sent = _frame_count(kit)
            with pytest.raises(PermissionDenied):
                await kit.call(operation, remote_actor(role=role), **params)
            assert _frame_count(kit) == sent
            assert kit.trail.entries[-1].outcome == "plant.forbidden"

    run(scenario())


def test_the_end_of_the_service_loses_no_count_of_denied_operations() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            for _ in range(3):
                with pytest.raises(PermissionDenied):
                    await kit.call("drive.stop", remote_actor(role=Role.VIEWER), drive="fan-1")
            await kit.service.stop()
            assert kit.trail.entries[-1].params["times"] == 2

    run(scenario())


def _frame_count(kit: ServiceKit) -> int:
    return sum(bus.frame_count for bus in kit.service.plant.buses.values())


def test_all_wrong_parameters_are_reported_and_unknown_ids_are_not_found() -> None:
    """A number in a string and an unknown name are not accepted."""

    async def scenario() -> None:
        async with running_service() as kit:
            with pytest.raises(InvalidParameters) as rejected:
                await kit.call("drive.run", drive="fan-1", frequency_hz="25.0", colour="red")
            assert {fault["path"] for fault in rejected.value.params["faults"]} == {"frequency_hz", "colour"}
            for operation, params in (("drives.get", {"drive": "unknown"}), ("nothing.at_all", {})):
                with pytest.raises(NotFound):
                    await kit.service.call(operation, params, LOCAL)

    run(scenario())


def test_a_subscriber_gets_a_snapshot_and_then_changes() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(5)
            live = kit.service.live("state", LOCAL)
            first = await anext(live)
            assert first["type"] == "snapshot" and {"drives/fan-1", "plant"} <= set(first["topics"])
            second = await anext(live)
            assert second["type"] == "update" and set(second["topics"]) < set(first["topics"])

    run(scenario())


def test_a_write_to_eeprom_needs_its_own_right() -> None:

    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(5)
            tuner = Actor("tom", frozenset({Right.VIEW, Right.OPERATE, Right.WRITE_PARAMETERS}), "s-tom", remote=False)
            values = {"F0.1": 2.0}
            with pytest.raises(PermissionDenied):
                await kit.call("parameters.write", tuner, drive="fan-1", values=values, save=True)
            found = await kit.call("parameters.write", tuner, drive="fan-1", values=values)
            assert found["outcome"]["status"] == "confirmed"

    run(scenario())


def test_a_write_that_fails_after_its_first_parameter_leaves_an_event_with_what_was_written(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The first value stays in the drive."""
    send = parameters._write_one

    def write_one(op: Any, wanted: Any, *, save: bool) -> Any:
        if wanted.parameter.notation != "F0.1":
            return op.outcome(OutcomeStatus.FAILED, "drives.write_differs", found=0, notation="F", value=1, unit="")
        return (yield from send(op, wanted, save=save))

    monkeypatch.setattr(parameters, "_write_one", write_one)

    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(5)

            def events() -> list[str]:
                found = [event for _, event in kit.service.plant.hub.items("events")]
                return [event["text"]["en"] for event in found if event["kind"] == "configuration"]

            with pytest.raises(TargetNotReached):
                await kit.call("parameters.write", drive="fan-1", values={second: 1.0, "F0.1": 2.0})
            assert events() == [], "nothing was written"
            with pytest.raises(TargetNotReached):
                await kit.call("parameters.write", drive="fan-1", values={"F0.1": 2.0, second: 1.0})
            (text,) = events()
            assert text.startswith("parameters written before the command ended: F0.1 = 2, read back; then: ")

    profile = profiles.load("c320")
    second = next(
        parameter.notation
        for parameter in profile.parameters.values()
        if parameter.writable and parameter.notation.startswith("F1")
    )
    run(scenario())


def test_parameters_are_read_with_their_wire_address_and_written_only_with_control() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(5)
            found = (await kit.call("parameters.read", drive="fan-1", names=["F0.1", "output_frequency"]))["parameters"]
            assert (found["F0.1"]["value"], found["F0.1"]["address_hex"]) == (2, "0001H")
            assert found["output_frequency"]["unit"] == "Hz"
            with pytest.raises(ControlNotHeld):
                await kit.call(
                    "parameters.write", remote_actor(role=Role.ENGINEER), drive="fan-1", values={"F0.1": 2.0}
                )

    run(scenario())


def test_a_name_that_the_model_lacks_is_refused_with_similar_names_and_the_others_are_read() -> None:
    """Regression: a wrong name refused all of them, although the command ``read`` reads the others."""

    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(5)
            found = await kit.call("parameters.read", drive="fan-1", names=["F0.1", "output_frequncy", "F99.1"])
            assert [*found["parameters"]] == ["F0.1"] and found["parameters"]["F0.1"]["value"] == 2
            assert [*found["refused"]] == ["output_frequncy", "F99.1"]
            error = found["refused"]["output_frequncy"]
            assert (error["kind"], error["code"]) == ("ProfileError", "profiles.unknown_name_near")
            assert "output_frequency" in error["text"]["en"] and "output_frequency" in error["text"]["zh"]
            none = await kit.call("parameters.read", drive="fan-1", names=["nothing"])
            assert none["parameters"] == {} and [*none["refused"]] == ["nothing"]

    run(scenario())


def test_the_search_for_names_like_64_unknown_ones_leaves_turns_of_the_loop_to_others() -> None:
    """It took up to 40 ms at once, in which no bus sends and no stop begins."""

    async def scenario() -> None:
        async with running_service() as kit:
            turns = 0

            async def count_turns() -> None:
                nonlocal turns
                while True:
                    await asyncio.sleep(0)
                    turns += 1

            counting = asyncio.create_task(count_turns())
            found = await kit.call("parameters.read", drive="fan-1", names=[f"nothing-{n}" for n in range(64)])
            counting.cancel()
            assert len(found["refused"]) == 64 and turns >= 30

    run(scenario())


def test_the_identity_of_a_c320_is_read_and_a_model_without_one_is_refused() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(5)
            found = await kit.call("identity.read", drive="fan-1")
            assert (found["voltage_class_v"], found["power_kw"]) == (380, 2.2)
            assert set(found["digits"]) == {"model", "series", "version", "control"}
            assert found["host_controls"] in (True, False) and found["host_sets_frequency"] is True
            other = next(
                drive.id for drive in kit.service.plant.drives.values() if "identify" not in drive.profile.capabilities
            )
            with pytest.raises(CapabilityError):
                await kit.call("identity.read", drive=other)

    run(scenario())


def test_a_profile_is_returned_whole() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            found = await kit.call("drives.profile", drive="fan-1")
            assert found["model"] == "c320" and found["can_write_ram"] and found["can_save"]
            profile = profiles.load("c320")
            assert [item["name"] for item in found["signals"]] == [*profile.signals]
            assert [item["notation"] for item in found["parameters"]] == [*profile.parameters]
            assert [item["code"] for item in found["faults"]] == [*profile.faults]
            assert [item["id"] for item in found["caveats"]] == [caveat.id for caveat in profile.caveats]
            assert [item["name"] for item in found["open_questions"]] == [
                question.name for question in profile.open_questions
            ]
            assert {"notation", "address_hex", "text", "evidence"} <= found["parameters"][0].keys()
            assert all(text["en"] and text["zh"] for text in found["keypad"])
            assert found["status_bits"] == []
            bits = (await kit.call("models.get", model="vc660"))["status_bits"]
            assert {bit["name"]: bit["mask"] for bit in bits} == profiles.load("vc660").status.bits  # type: ignore[union-attr]
            assert bits[4]["text"] == {"en": "emergency stop under way", "zh": "紧急停车过程中"}

    run(scenario())
