"""Stops: they need no lease, arm token or audit trail, cancel earlier commands, and report their result."""

from __future__ import annotations

import asyncio
import logging
from contextlib import nullcontext
from dataclasses import replace
from functools import partial

import pytest

from drivebus import i18n
from drivebus.bus.station import Presence
from drivebus.drives.drive import Drive
from drivebus.drives.outcome import Outcome
from drivebus.drives.state import DriveState
from drivebus.errors import (
    ArmRequired,
    AuditUnavailable,
    DrivebusError,
    LimitError,
    NoReply,
    NotFound,
    ServiceUnavailable,
    StartInhibited,
    StopUnconfirmed,
    Superseded,
)
from drivebus.ports import open_port
from drivebus.profiles.diagnostics import bilingual_text
from drivebus.service.audit.description import described
from drivebus.service.audit.records import entry_json
from drivebus.service.auth.rights import Role
from drivebus.service.config.model import BusConfig, DriveConfig, GroupConfig, OnClientLost, OnServiceStop, PlantConfig
from drivebus.service.runtime.drive_reports import STANDSTILL_CONFIRM_S, report_motion
from drivebus.simulator.motor import OutputPhase
from drivebus.simulator.port import simulated_bus_of
from drivebus.testing.virtual_time import run
from drivebus.types import Json
from drivebus.values import Text
from fixtures.drives import SimulatedDrives
from fixtures.service import BUSES, DRIVES, LOCAL, ServiceKit, plant_config, remote_actor, running_service


async def ready(kit: ServiceKit, *drives: str) -> None:
    """Wait until every drive may be started, and start these."""
    await asyncio.sleep(5)
    await kit.grant_waivers()
    for drive in drives:
        await kit.call("drive.run", drive=drive, frequency_hz=20.0)


def state(kit: ServiceKit, drive: str) -> DriveState:
    return kit.service.plant.drives[drive].status().state


async def commanded_hz(kit: ServiceKit, *drives: str) -> list[float | None]:
    return [(await kit.call("drives.get", drive=drive))["commanded_hz"] for drive in drives]


def test_a_stop_needs_no_lease_no_arm_token_and_no_audit_trail() -> None:
    """Another session controls the drive and the trail cannot be written."""

    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit, "fan-1")
            kit.trail.broken = True
            found = await kit.call("drive.stop", remote_actor("bob"), drive="fan-1")
            assert found["outcome"]["status"] == "confirmed"
            with pytest.raises(AuditUnavailable):
                await kit.call("drive.run", drive="fan-1", frequency_hz=20.0)
            assert [entry.params["what"] for entry in kit.trail.entries if entry.what == "audit.refused"] == [
                "drive.run"
            ]
            assert "plant.audit_unavailable" in [blocker["key"] for blocker in await blocked(kit, "fan-1")]
            kit.trail.broken = False
            await kit.call("drive.run", drive="fan-1", frequency_hz=20.0)

    run(scenario())


def test_a_confirmed_stop_updates_the_state_at_once_where_polls_are_slow() -> None:
    """The page must not show a running drive beside a confirmed stop until the next poll in 20 s."""

    async def scenario() -> None:
        slow = tuple(replace(drive, min_poll_interval_s=20.0) for drive in DRIVES)
        async with running_service(plant_config(drives=slow)) as kit:
            await asyncio.sleep(45)
            await ready(kit, "fan-1", "pump-1")
            for drive in ("fan-1", "pump-1"):
                assert state(kit, drive).turning
                found = await kit.call("drive.stop", drive=drive)
                assert found["outcome"]["status"] == "confirmed"
                assert state(kit, drive) is DriveState.STOPPED

    run(scenario())


def test_a_view_lists_a_bad_link_as_start_blocker() -> None:
    """A link is bad with three damaged replies in five minutes that are more than 1 % of all."""

    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit)
            assert not await blocked(kit, "fan-1")
            bench = simulated_bus_of(kit.service.plant.drives["fan-1"].bus.port)
            for quality in ("flip=0.02", "clean"):
                bench.line_quality = quality
                await asyncio.sleep(20)
            assert [blocker["key"] for blocker in await blocked(kit, "fan-1")] == ["drives.high_error_rate"]
            with pytest.raises(StartInhibited):
                await kit.call("drive.run", drive="fan-1", frequency_hz=20.0)
            assert kit.station("fan-1").motor.starts == 0

    run(scenario())


async def blocked(kit: ServiceKit, drive: str) -> list[dict[str, object]]:
    found: list[dict[str, object]] = (await kit.call("drives.get", drive=drive))["start_blockers"]
    return found


def test_a_start_is_rejected_where_its_own_audit_record_fails() -> None:
    """The trail reported no error before it."""

    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit)
            kit.trail.fails_silently = True
            with pytest.raises(AuditUnavailable):
                await kit.call("drive.run", drive="fan-1", frequency_hz=20.0)
            with pytest.raises(AuditUnavailable):
                await kit.call("drive.jog", drive="fan-1")
            assert kit.station("fan-1").motor.starts == 0
            await kit.call("drive.stop", drive="fan-1")

    run(scenario())


def test_a_setpoint_is_sent_where_the_audit_trail_cannot_be_written() -> None:
    """Only starts require a record."""

    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit, "fan-1")
            kit.trail.broken = True
            found = await kit.call("drive.set_frequency", drive="fan-1", frequency_hz=30.0)
            assert found["outcome"]["status"] == "acknowledged"  # what a C320 can show of it
            recorded = [entry.what for entry in kit.trail.entries]
            assert recorded[-1] == "drive.set_frequency" and "audit.refused" not in recorded
            assert [alarm.subject for alarm in kit.service.plant.alarms.active() if alarm.kind == "audit_failure"]

    run(scenario())


def test_a_stop_while_a_start_is_being_recorded_cancels_the_start() -> None:
    """The start was commanded before the stop, however long its record takes."""

    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit)
            kit.trail.delay_s = 0.5
            start = asyncio.create_task(kit.call("drive.run", drive="fan-1", frequency_hz=20.0))
            await asyncio.sleep(0.1)
            await kit.call("drive.stop", drive="fan-1")
            with pytest.raises(Superseded) as rejected:
                await start
            assert rejected.value.may_be_running is False
            await asyncio.sleep(2)
            assert state(kit, "fan-1") is DriveState.STOPPED
            assert kit.station("fan-1").motor.starts == 0

    run(scenario())


def test_a_start_whose_record_takes_too_long_expires() -> None:

    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit)
            kit.trail.delay_s = 3.0
            with pytest.raises(DrivebusError, match="recording the command") as rejected:
                await kit.call("drive.run", drive="fan-1", frequency_hz=20.0)
            assert rejected.value.may_be_running is False and kit.station("fan-1").motor.starts == 0

    run(scenario())


def test_a_start_that_the_service_refuses_has_left_no_motor_running() -> None:
    """No stop follows it at the command line: another user may have started the drive."""

    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit)
            with pytest.raises(LimitError) as rejected:
                await kit.call("drive.run", drive="fan-1", frequency_hz=500.0)
            assert rejected.value.may_be_running is False

    run(scenario())


@pytest.mark.parametrize(("may_be_running", "counts"), [(True, True), (None, True), (False, False)])
def test_a_failed_start_counts_as_one_of_the_service_unless_the_drive_knows_better(
    monkeypatch: pytest.MonkeyPatch, may_be_running: bool | None, counts: bool
) -> None:
    """The end of its lease stops the drive then, and an earlier stop is no longer shown."""

    async def failing(*_: object, **__: object) -> None:
        error = NoReply("bus.no_reply", station=1)
        error.may_be_running = may_be_running
        raise error

    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit)
            await kit.call("drive.stop", drive="fan-1")
            monkeypatch.setattr(Drive, "run", failing)
            with pytest.raises(NoReply):
                await kit.call("drive.run", drive="fan-1", frequency_hz=20.0)
            runtime = kit.service.plant.drives["fan-1"]
            assert (runtime.started_by_service, runtime.last_stop is None) == (counts, counts)

    run(scenario())


@pytest.mark.parametrize("replies", [True, False])
def test_a_start_during_which_an_earlier_stop_is_confirmed_counts_as_one_of_the_service(replies: bool) -> None:
    """The end of the service would have left it running, also where the start had no reply."""

    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit)
            runtime = kit.service.plant.drives["fan-1"]

            async def start() -> Outcome:
                runtime.end_motion()  # as at the confirmation of the stop
                if replies:
                    return await runtime.drive.run(5.0)
                error = NoReply("bus.no_reply", station=1)
                error.may_be_running = True
                raise error

            with nullcontext() if replies else pytest.raises(NoReply):
                await kit.service.commands.run_motion(runtime, start())
            assert runtime.started_by_service
            await asyncio.sleep(2)
            assert [event for event in kit.history.events if event["kind"] == "start"] == [], "it was started here"

    run(scenario())


def test_a_stop_by_any_actor_revokes_arm_tokens() -> None:

    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit)
            ann = remote_actor()
            await kit.call("lease.take", ann, drive="fan-1")
            arm = (await kit.call("drive.arm", ann, drive="fan-1"))["arm_token"]
            await kit.call("drive.stop", remote_actor("bob"), drive="fan-1")
            with pytest.raises(ArmRequired):
                await kit.call("drive.run", ann, drive="fan-1", frequency_hz=20.0, arm_token=arm)

    run(scenario())


def test_an_arm_token_is_valid_for_ten_seconds_one_drive_and_one_session() -> None:
    """Only the monotonic time of the service counts."""

    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit)
            ann, twin = remote_actor(), remote_actor("ann", session="another")
            for drive in ("fan-1", "fan-2"):
                await kit.call("lease.take", ann, drive=drive)
            arm = (await kit.call("drive.arm", ann, drive="fan-1"))["arm_token"]
            with pytest.raises(ArmRequired):
                await kit.call("drive.run", ann, drive="fan-2", frequency_hz=20.0, arm_token=arm)
            arm = (await kit.call("drive.arm", ann, drive="fan-1"))["arm_token"]
            for _ in range(3):
                await asyncio.sleep(3.4)
                await kit.call("lease.renew", ann, drive="fan-1")
            with pytest.raises(ArmRequired):
                await kit.call("drive.run", ann, drive="fan-1", frequency_hz=20.0, arm_token=arm)
            arm = (await kit.call("drive.arm", ann, drive="fan-1"))["arm_token"]
            await kit.call("lease.release", ann, drive="fan-1")
            await kit.call("lease.take", twin, drive="fan-1")
            with pytest.raises(ArmRequired):
                await kit.call("drive.run", twin, drive="fan-1", frequency_hz=20.0, arm_token=arm)

    run(scenario())


def test_after_a_stop_of_everything_starts_stay_inhibited_until_released() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit, "fan-1", "pump-1")
            assert await commanded_hz(kit, "fan-1", "pump-1") == [20.0, 20.0]
            found = await kit.call("plant.stop", remote_actor(role=Role.OPERATOR))
            assert await commanded_hz(kit, "fan-1", "pump-1") == [None, None]
            assert {bus: report["confirmed"] for bus, report in found["buses"].items()} == {"a": True, "b": True}
            assert found["outcomes"]["pump-1"]["status"] == "confirmed"
            with pytest.raises(StartInhibited):
                await kit.call("drive.run", drive="fan-1", frequency_hz=20.0)
            assert "drives.start_inhibited" in [blocker["key"] for blocker in await blocked(kit, "fan-1")]
            for _ in range(2):
                await kit.call("start_inhibit.release", drive="fan-1")
            assert kit.drives_of_events("plant.released") == ["fan-1"], "the second time nothing inhibited it"
            await kit.call("drive.run", drive="fan-1", frequency_hz=20.0)

    run(scenario())


def test_a_bus_stop_lists_a_drive_that_cannot_report_as_acknowledged() -> None:
    async def scenario() -> None:
        saw = DriveConfig(id="saw", bus="c", address=1, model="df800", title=Text("Saw", "锯"))
        config = plant_config(buses=(*BUSES, BusConfig("c", "sim://df800@1")), drives=(*DRIVES, saw))
        async with running_service(config) as kit:
            await asyncio.sleep(5)
            buses = (await kit.call("plant.stop"))["buses"]
            shown = {bus: (one["confirmed"], one["acknowledged"], one["unconfirmed"]) for bus, one in buses.items()}
            assert shown == {"a": (True, [], []), "b": (True, [], []), "c": (False, ["saw"], [])}
            assert "stop_unconfirmed" not in kinds(kit)
            assert kit.drives_of_events("plant.did_stop_all_acknowledged", drives="saw") == [None]
            assert kit.drives_of_events("plant.did_stop_all") == []

    run(scenario())


def test_the_event_of_each_command_says_what_was_sent_and_how_it_ended() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit)
            answers = {
                "plant.did_run": await kit.call("drive.run", drive="fan-1", frequency_hz=20.0),
                "plant.did_set_frequency": await kit.call("drive.set_frequency", drive="fan-1", frequency_hz=10.0),
                "plant.did_stop": await kit.call("drive.stop", drive="fan-1"),
                "plant.did_write": await kit.call("parameters.write", drive="fan-1", values={"F1.10": 1.0}),
                "plant.did_jog": await kit.call("drive.jog", drive="fan-1", frequency_hz=5.0),
            }
            for operation, params in (
                ("drive.run", {"frequency_hz": 500.0}),
                ("drive.set_frequency", {"frequency_hz": 500.0}),
                ("drive.jog", {"frequency_hz": 500.0}),
                ("parameters.write", {"values": {"F0.2": 700.0}}),
            ):
                with pytest.raises(LimitError):
                    await kit.call(operation, drive="pump-1" if "values" not in params else "fan-2", **params)
            for (key, answer), hz in zip(answers.items(), (20.0, 10.0, None, None, None), strict=True):
                how = Text.from_mapping(answer["outcome"]["text"])
                assert kit.drives_of_events(key, frequency_hz=hz, how=how) == ["fan-1"], key
            kinds = ("command", "stop", "configuration")
            events = [event["drive"] for event in kit.history.events if event["kind"] in kinds]
            assert events == ["fan-1"] * len(answers), "a refused command did nothing"

    run(scenario())


def test_a_bus_stop_of_a_plant_without_drives_is_not_called_a_stop_of_drives() -> None:
    async def scenario(config: PlantConfig) -> str:
        async with running_service(config) as kit:
            await asyncio.sleep(5)
            await kit.call("plant.stop")
            return str([event["text"]["en"] for _, event in kit.service.plant.hub.items("events")][-1])

    empty, whole = run(scenario(plant_config(drives=(), groups=()))), run(scenario(plant_config()))
    assert empty == i18n.text("plant.did_stop_all_no_drives", "en")
    assert whole == i18n.text("plant.did_stop_all", "en")


def test_a_lost_bus_is_reported_as_unconfirmed_and_the_others_are_stopped() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit, "fan-1", "pump-1")
            simulated_bus_of(kit.service.plant.drives["fan-1"].bus.port).unplug()
            found = await kit.call("plant.stop")
            assert found["buses"]["a"]["unconfirmed"] == ["fan-1", "fan-2"]
            assert found["buses"]["b"]["confirmed"]
            kinds = {(alarm.kind, alarm.drive) for alarm in kit.service.plant.alarms.active()}
            assert ("stop_unconfirmed", "fan-1") in kinds

    run(scenario())


def test_an_unconfirmed_stop_raises_an_alarm_until_a_stop_is_confirmed() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit, "fan-1")
            bench = simulated_bus_of(kit.service.plant.drives["fan-1"].bus.port)
            bench.unplug()
            with pytest.raises(StopUnconfirmed):
                await kit.call("drive.stop", drive="fan-1")
            assert "stop_unconfirmed" in kinds(kit)
            bench.replug()
            await asyncio.sleep(15)
            assert await commanded_hz(kit, "fan-1") == [None], "the repeated stop was confirmed"
            await kit.call("drive.stop", drive="fan-1")
            assert "stop_unconfirmed" not in kinds(kit)

    run(scenario())


def test_a_stop_that_a_lost_port_withholds_is_called_unsent_and_sent_when_the_port_is_open_again() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit, "fan-1")
            bench = simulated_bus_of(kit.service.plant.drives["fan-1"].bus.port)
            bench.unplug()
            await asyncio.sleep(6)
            with pytest.raises(StopUnconfirmed) as caught:
                await kit.call("drive.stop", drive="fan-1")
            assert caught.value.key == "plant.stop_not_sent_port"
            assert "STOP NOT SENT: the port is not open" in str(caught.value)
            assert "The service sends it when the port is open again" in str(caught.value)
            ended = described([entry_json(one, 0) for one in kit.trail.entries if one.what == "drive.stop"][-1])
            assert ended["outcome_text"]["en"].startswith("STOP NOT SENT: the port is not open (sim://")
            assert ended["outcome_text"]["zh"].startswith("停机命令未发送：端口未打开（")
            whole = (await kit.call("plant.stop"))["outcomes"]["fan-1"]
            assert (whole["status"], whole["key"]) == ("unknown", "plant.stop_not_sent_port")
            alarms = [alarm.text.en for alarm in kit.service.plant.alarms.active()]
            assert "Fan 1: a stop is requested and the drive does not report stopped; use the hard-wired stop" in alarms
            bench.replug()
            await asyncio.sleep(6)
            assert kit.station("fan-1").motor.phase is OutputPhase.OFF

    run(scenario())


@pytest.mark.parametrize(("delay_s", "key"), [(0.06, "plant.stop_port_lost"), (0.5, "plant.stop_port_lost_after")])
def test_a_port_lost_during_a_stop_is_reported_with_its_repetition_by_the_service(delay_s: float, key: str) -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit, "fan-1")
            bench = simulated_bus_of(kit.service.plant.drives["fan-1"].bus.port)
            asyncio.get_running_loop().call_later(delay_s, bench.unplug)
            with pytest.raises(StopUnconfirmed) as caught:
                await kit.call("drive.stop", drive="fan-1")
            assert caught.value.key == key
            assert "The service sends it again when the port is open again" in str(caught.value)
            bench.replug()
            await asyncio.sleep(8)
            assert kit.station("fan-1").motor.phase is OutputPhase.OFF

    run(scenario())


def test_a_stop_on_a_bus_that_was_never_opened_is_not_promised_for_later() -> None:
    """Its repetition ends at once, because no port is opened again."""

    async def scenario() -> None:
        async with running_service(plant_config(buses=(BusConfig("a", "/nonexistent/tty"), BUSES[1]))) as kit:
            with pytest.raises(StopUnconfirmed) as caught:
                await kit.call("drive.stop", drive="fan-1")
            assert caught.value.key == "drives.stop_not_sent_port"

    run(scenario())


def kinds(kit: ServiceKit) -> set[str]:
    return {alarm.kind for alarm in kit.service.plant.alarms.active() if alarm.cleared_ms is None}


@pytest.mark.parametrize("policy", list(OnClientLost))
def test_a_lost_client_triggers_the_policy_of_its_drive(policy: OnClientLost) -> None:
    """The drive runs on with an alarm, or is stopped."""

    async def scenario() -> None:
        drives = tuple(replace(drive, on_client_lost=policy) for drive in DRIVES)
        async with running_service(plant_config(drives=drives)) as kit:
            await ready(kit)
            ann = remote_actor()
            await kit.call("lease.take", ann, drive="fan-1")
            arm = (await kit.call("drive.arm", ann, drive="fan-1"))["arm_token"]
            await kit.call("drive.run", ann, drive="fan-1", frequency_hz=20.0, arm_token=arm)
            for _ in range(5):
                await asyncio.sleep(3)
                await kit.call("lease.renew", ann, drive="fan-1")
            assert state(kit, "fan-1").turning
            await asyncio.sleep(15)
            held = policy is OnClientLost.HOLD
            assert state(kit, "fan-1").turning is held
            lost = [alarm.text.en for alarm in kit.service.plant.alarms.active() if alarm.kind == "control_lost"]
            assert lost == ["Fan 1 runs, and the session that had control is lost"] * held
            assert kit.drives_of_events("plant.lease_lost", owner="ann") == ["fan-1"]
            assert kit.drives_of_events("plant.stopped_client_lost", owner="ann") == ["fan-1"] * (not held)

    run(scenario())


def test_only_an_engineer_takes_a_lease_from_another_session() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit)
            await kit.call("lease.take", remote_actor("ann"), drive="fan-1")
            with pytest.raises(DrivebusError, match="ann has control"):
                await kit.call("lease.take", remote_actor("bob"), drive="fan-1")
            taken = await kit.call("lease.take", remote_actor("eve", Role.ENGINEER), drive="fan-1")
            assert taken["lease"]["owner"] == "eve"
            assert kit.drives_of_events("plant.lease_taken", owner="ann") == ["fan-1"]
            await kit.call("lease.release", remote_actor("eve", Role.ENGINEER), drive="fan-1")
            await kit.call("lease.take", remote_actor("bob"), drive="fan-1")
            assert kit.drives_of_events("plant.lease_taken", owner="eve") == [], "eve had released it"

    run(scenario())


def test_a_drive_whose_status_fails_does_not_keep_an_ending_service_from_stopping_the_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail() -> None:
        raise ValueError("broken")

    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit, "fan-1")
            runtime, station = kit.service.plant.drives["pump-1"], kit.station("fan-1")
            monkeypatch.setattr(logging.getLogger("drivebus.service"), "exception", lambda *_: None)
            monkeypatch.setattr(runtime, "status", fail)
            monkeypatch.setattr(runtime, "state_was_known", False)
            outcomes = await kit.service.stop()
            assert [*outcomes] == ["fan-1"] and station.motor.phase is OutputPhase.OFF
            assert "pump-1" in kit.drives_of_events("plant.left_unknown")

    run(scenario())


@pytest.mark.parametrize("policy", list(OnServiceStop))
def test_a_stopping_service_stops_the_drives_that_it_started_by_their_policy(
    policy: OnServiceStop, caplog: pytest.LogCaptureFixture
) -> None:
    """Drives that others started run on; the log warns of each that may be running."""

    async def scenario() -> None:
        drives = tuple(replace(drive, on_service_stop=policy) for drive in DRIVES)
        async with running_service(plant_config(drives=drives)) as kit:
            await ready(kit, "fan-1")
            kit.station("fan-2").motor.run(20.0)
            await asyncio.sleep(3)
            stations = kit.station("fan-1"), kit.station("fan-2")
            simulated_bus_of(kit.service.plant.drives["pump-1"].bus.port).unplug()
            await asyncio.sleep(10)
            outcomes = await kit.service.stop()
            stopped = policy is OnServiceStop.STOP
            assert [*outcomes] == (["fan-1"] if stopped else [])
            assert [station.motor.phase is OutputPhase.OFF for station in stations] == [stopped, False]
            assert kit.drives_of_events("plant.held") == ([] if stopped else ["fan-1"])
            assert kit.drives_of_events("plant.left_running") == ["fan-2"]
            assert kit.drives_of_events("plant.left_unknown") == ["pump-1", "pump-2"]
            records = [record for record in caplog.records if "running" in record.message]
            left = ["fan-2", "pump-1", "pump-2"] if stopped else ["fan-1", "fan-2", "pump-1", "pump-2"]
            assert [(vars(one)["event"]["drive"], one.levelname) for one in records] == [(id, "WARNING") for id in left]

    run(scenario())


@pytest.mark.parametrize("by_service", [True, False], ids=["hold policy", "started by another"])
def test_a_stopping_service_stops_a_drive_whose_ramp_it_holds(by_service: bool) -> None:
    """Nothing else would end the hold: the motor would stay at a frequency that it was only passing."""

    async def scenario() -> None:
        drives = tuple(replace(drive, on_service_stop=OnServiceStop.HOLD) for drive in DRIVES)
        buses = (BUSES[0], replace(BUSES[1], port="sim://vc660@1,2?ramp=20"))
        async with running_service(plant_config(drives=drives, buses=buses)) as kit:
            await ready(kit, *(["pump-1"] if by_service else []))
            station = kit.station("pump-1")
            if not by_service:
                station.motor.run(40.0)
            await asyncio.sleep(2)
            holding = asyncio.create_task(kit.call("drive.hold_ramp", drive="pump-1", seconds=10.0))
            await asyncio.sleep(1)
            assert station.motor.hold
            outcomes = await kit.service.stop()
            assert [*outcomes] == ["pump-1"] and station.motor.phase is OutputPhase.OFF and not station.motor.hold
            with pytest.raises(Superseded):
                await holding

    run(scenario())


@pytest.mark.parametrize("by_service", [True, False], ids=["started by the service", "started at the keypad"])
@pytest.mark.parametrize("lost", [False, True], ids=["answered", "its first frame lost"])
def test_a_service_that_ends_during_the_stop_of_a_drive_that_it_holds_waits_for_that_stop(
    lost: bool, by_service: bool
) -> None:
    """It closed the bus: a stop whose frame was lost was not repeated, and its request ended with an internal error."""

    async def scenario() -> None:
        drives = tuple(replace(drive, on_service_stop=OnServiceStop.HOLD) for drive in DRIVES)
        async with running_service(plant_config(drives=drives)) as kit:
            await ready(kit, *(["fan-1"] if by_service else []))
            station = kit.station("fan-1")
            if not by_service:
                station.motor.run(20.0)
                await asyncio.sleep(2)
            station.faults.silent = lost
            asyncio.get_running_loop().call_later(0.2, setattr, station.faults, "silent", False)
            stop = asyncio.create_task(kit.call("drive.stop", remote_actor("bob"), drive="fan-1"))
            await asyncio.sleep(0.01)
            assert await kit.service.stop() == {}
            assert (await stop)["outcome"]["status"] == "confirmed"
            assert station.motor.phase is OutputPhase.OFF
            assert kit.drives_of_events("plant.held") == kit.drives_of_events("plant.left_running") == []

    run(scenario())


def test_a_stop_that_is_not_confirmed_when_the_service_has_ended_is_reported_as_unknown() -> None:
    """An event named it as kept in its state."""

    async def scenario() -> None:
        drives = tuple(replace(drive, on_service_stop=OnServiceStop.HOLD) for drive in DRIVES)
        buses = (BUSES[0], replace(BUSES[1], port="sim://vc660@1,2?ramp=20"))
        async with running_service(plant_config(drives=drives, buses=buses)) as kit:
            await ready(kit, "pump-1")
            await asyncio.sleep(10)
            stop = asyncio.create_task(kit.call("drive.stop", drive="pump-1"))
            await asyncio.sleep(0.1)
            assert await kit.service.stop() == {"pump-1": None}
            assert kit.drives_of_events("plant.held") == []
            with pytest.raises(DrivebusError):
                await stop

    run(scenario())


async def test_a_stop_that_is_under_way_when_its_drive_leaves_the_bus_ends_without_an_internal_error() -> None:
    async with SimulatedDrives("c320") as bench:
        drive = Drive(bench.bus, "c320", 1)
        stop = asyncio.create_task(drive.stop())
        await asyncio.sleep(0.005)
        assert drive.stopping
        drive.close()
        with pytest.raises(DrivebusError):
            await stop


@pytest.mark.parametrize(("after_s", "known"), [(0.0, False), (0.2, False), (0.6, True)])
def test_a_service_that_ends_around_the_first_read_of_running_drives_stops_them(after_s: float, known: bool) -> None:
    """A killed service had started them; the supervision of this one has not had its turn since that read."""

    async def scenario() -> None:
        async with running_service() as kit:
            stations = {id: kit.station(id) for id in ("fan-1", "pump-1")}
            for station in stations.values():
                station.motor.run(20.0)
            await asyncio.sleep(after_s)
            runtime = kit.service.plant.drives["fan-1"]
            assert (runtime.status().state.turning, runtime.state_was_known) == (known, False)
            assert (await kit.service.stop()).keys() == stations.keys()
            assert all(station.motor.phase is OutputPhase.OFF for station in stations.values())
            assert kit.drives_of_events("plant.left_unknown") == []

    run(scenario())


WITHOUT_RUN_STATE = {"drives": (replace(DRIVES[0], model="df800"),), "buses": (BusConfig("a", "sim://df800@1"),)}
WITHOUT_REPLIES = {"buses": tuple(replace(bus, port=bus.port.replace("@1,2", "@3")) for bus in BUSES)}
WITHOUT_PORT = {"buses": tuple(replace(bus, port="/dev/absent") for bus in BUSES)}


@pytest.mark.parametrize(
    "plant", [WITHOUT_RUN_STATE, WITHOUT_REPLIES, WITHOUT_PORT], ids=["run state", "replies", "port"]
)
def test_a_service_that_ends_does_not_wait_for_the_state_of_drives_that_can_not_be_read(plant: Json) -> None:
    async def scenario() -> None:
        async with running_service(plant_config(groups=(), **plant)) as kit:
            drives = list(kit.service.plant.drives)
            await asyncio.sleep(5)
            ends_at = kit.service.plant.now()
            assert await kit.service.stop() == {}
            assert kit.service.plant.now() - ends_at < 0.2
            assert kit.drives_of_events("plant.left_unknown") == drives

    run(scenario())


def test_a_stopping_service_reports_unconfirmed_stops_within_three_seconds() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit, "fan-1")
            simulated_bus_of(kit.service.plant.drives["fan-1"].bus.port).unplug()
            started_at = kit.service.plant.now()
            outcomes = await kit.service.stop()
            assert kit.service.plant.now() - started_at <= 3.0
            assert outcomes["fan-1"]["kind"] == "StopUnconfirmed" and "status" not in outcomes["fan-1"]

    run(scenario())


GROUP = GroupConfig(id="fans", drives=("fan-1", "fan-2", "pump-1"), start_interval_s=3.0, max_concurrent_starts=2)


def test_a_group_start_does_not_wait_for_the_turn_of_a_slow_poll() -> None:
    """Each drive waited for a poll of the one before, which was due 10 s later."""
    drives = tuple(replace(drive, min_poll_interval_s=10.0) for drive in DRIVES if drive.bus == "b")
    group = GroupConfig(id="pumps", drives=tuple(drive.id for drive in drives), title=Text("Pumps", "水泵"))

    async def scenario() -> None:
        async with running_service(plant_config(drives=drives, groups=(group,), buses=BUSES[1:])) as kit:
            await asyncio.sleep(15)
            await kit.grant_waivers()
            began = asyncio.get_running_loop().time()
            found = (await kit.call("group.start", group="pumps", frequency_hz=20.0))["outcomes"]
            assert [outcome["status"] for outcome in found.values()] == ["confirmed", "confirmed"]
            assert 1.0 < asyncio.get_running_loop().time() - began < 4.0

    run(scenario())


def test_a_group_starts_its_drives_in_sequence_and_a_stop_of_one_ends_it() -> None:
    async def scenario() -> None:
        async with running_service(plant_config(groups=(GROUP,))) as kit:
            await ready(kit)
            start = asyncio.create_task(kit.call("group.start", group="fans", frequency_hz=20.0))
            await asyncio.sleep(4.5)
            await kit.call("drive.stop", drive="fan-1")
            found = (await start)["outcomes"]
            assert [found[drive].get("status") for drive in GROUP.drives] == ["confirmed", "confirmed", None]
            assert found["pump-1"]["kind"] == "Superseded"
            assert kit.station("pump-1").motor.starts == 0

    run(scenario())


def test_a_group_that_is_starting_is_not_started_again_until_that_has_ended() -> None:
    async def scenario() -> None:
        async with running_service(plant_config(groups=(GROUP,))) as kit:
            await ready(kit)
            start = asyncio.create_task(kit.call("group.start", group="fans", frequency_hz=20.0))
            await asyncio.sleep(1)
            with pytest.raises(Superseded) as caught:
                await kit.call("group.start", group="fans", frequency_hz=10.0)
            assert caught.value.key == "plant.group_starting"
            await start
            assert await commanded_hz(kit, *GROUP.drives) == [20.0] * 3
            assert "fan-1" in (await kit.call("group.start", group="fans", frequency_hz=10.0))["outcomes"]

    run(scenario())


def test_a_group_whose_lease_was_lost_starts_no_further_drive() -> None:
    async def scenario() -> None:
        async with running_service(plant_config(groups=(replace(GROUP, start_interval_s=7.0),))) as kit:
            await ready(kit)
            ann = remote_actor()
            for drive in GROUP.drives:
                await kit.call("lease.take", ann, drive=drive)
            arm = (await kit.call("group.arm", ann, group="fans"))["arm_token"]
            found = (await kit.call("group.start", ann, group="fans", frequency_hz=20.0, arm_token=arm))["outcomes"]
            assert [found[drive].get("kind") for drive in GROUP.drives] == [None, None, "ControlNotHeld"]
            assert kit.station("pump-1").motor.starts == 0

    run(scenario())


def test_a_group_is_stopped_together() -> None:
    async def scenario() -> None:
        async with running_service(plant_config(groups=(replace(GROUP, start_interval_s=0.0),))) as kit:
            await ready(kit)
            found = await kit.call("group.start", group="fans", frequency_hz=20.0)
            assert {outcome["status"] for outcome in found["outcomes"].values()} == {"confirmed"}
            found = await kit.call("group.stop", remote_actor("bob"), group="fans")
            assert {outcome["status"] for outcome in found["outcomes"].values()} == {"confirmed"}

    run(scenario())


@pytest.mark.parametrize("start_interval_s", [0.0, 1.0])
def test_no_more_drives_of_a_group_accelerate_at_once_than_allowed(start_interval_s: float) -> None:
    async def scenario() -> None:
        buses = (replace(BUSES[0], port="sim://c320@1,2?ramp=8"), replace(BUSES[1], port="sim://vc660@1,2?ramp=8"))
        group = GroupConfig(
            id="fans", drives=("fan-1", "fan-2", "pump-1"), start_interval_s=start_interval_s, max_concurrent_starts=1
        )
        async with running_service(plant_config(buses=buses, groups=(group,))) as kit:
            await ready(kit)
            start = asyncio.create_task(kit.call("group.start", group="fans", frequency_hz=20.0))
            most = 0
            while not start.done():
                await asyncio.sleep(0.05)
                phases = [kit.station(drive).motor.phase.value for drive in group.drives]
                most = max(most, phases.count("accelerating"))
            assert most == 1
            assert {outcome["status"] for outcome in (await start)["outcomes"].values()} == {"confirmed"}

    run(scenario())


def test_followers_run_at_their_ratio_and_follow_their_leader() -> None:
    async def scenario() -> None:
        group = GroupConfig(id="fans", drives=("fan-1", "fan-2"), leader="fan-1", ratios={"fan-2": 0.5})
        async with running_service(plant_config(groups=(group,))) as kit:
            await ready(kit)
            await kit.call("group.start", group="fans", frequency_hz=20.0)
            assert kit.station("fan-2").motor.target_hz == 10.0
            found = await kit.call("drive.set_frequency", drive="fan-1", frequency_hz=30.0)
            assert found["followers"]["fan-2"]["status"] == "acknowledged"
            assert kit.station("fan-2").motor.target_hz == 15.0
            await kit.call("group.set_frequency", group="fans", frequency_hz=24.0)
            assert kit.station("fan-2").motor.target_hz == 12.0

    run(scenario())


def test_a_group_with_a_follower_above_its_limit_does_not_start() -> None:
    async def scenario() -> None:
        group = GroupConfig(id="fans", drives=("fan-1", "fan-2"), leader="fan-1", ratios={"fan-2": 30.0})
        async with running_service(plant_config(groups=(group,))) as kit:
            await ready(kit)
            with pytest.raises(LimitError) as caught:
                await kit.call("group.start", group="fans", frequency_hz=20.0)
            assert caught.value.params["frequency_hz"] == 600.0
            assert kit.station("fan-1").motor.starts == 0

    run(scenario())


@pytest.mark.parametrize("operation", ["group.start", "group.set_frequency"])
def test_a_limit_hit_at_a_ratio_names_the_drive_and_the_frequencies_that_the_group_may_have(operation: str) -> None:
    """It named neither: 36 Hz was above the maximum where 40 Hz had been entered for three drives."""

    async def scenario() -> None:
        group = GroupConfig(id="fans", drives=("fan-1", "fan-2"), leader="fan-1", ratios={"fan-2": 3.0})
        async with running_service(plant_config(groups=(group,))) as kit:
            await ready(kit)
            with pytest.raises(LimitError) as caught:
                await kit.call(operation, group="fans", frequency_hz=20.0)
            assert caught.value.text("en") == (
                "fan-2 gets 3.0 times the frequency of group fans: 60.0 Hz is above the maximum of 50.0 Hz; "
                "nothing was sent. fan-2 permits 0.0 Hz to 16.66 Hz for the group"
            )
            assert caught.value.text("zh").startswith("fan-2 的频率为组 fans 频率的 3.0 倍：")
            assert (await kit.call("group.start", group="fans", frequency_hz=16.66))["outcomes"]["fan-2"]["status"]

    run(scenario())


def test_a_group_with_an_offline_drive_is_not_called_stopped() -> None:
    """Its state was that of the last replies, which are good for three poll periods."""

    async def scenario() -> None:
        drives = tuple(replace(drive, min_poll_interval_s=10.0) for drive in DRIVES)
        async with running_service(plant_config(drives=drives)) as kit:
            await asyncio.sleep(30)
            view = partial(kit.service.groups.group_view, kit.service.plant.group("fans"))
            assert view()["state"] == "stopped"
            kit.station("fan-2").faults.silent = True
            runtime = kit.service.plant.drives["fan-2"]
            await asyncio.sleep(15)
            assert runtime.bus.presence(runtime.config.address) is Presence.OFFLINE
            assert runtime.status().state is DriveState.STOPPED and view()["state"] == "unknown"

    run(scenario())


def test_a_cap_of_an_unknown_setpoint_step_is_not_called_the_range_of_a_group(monkeypatch: pytest.MonkeyPatch) -> None:
    """The refusal limited the drive to 0.5 Hz and named a range up to 50 Hz."""

    def refuse(drive: Drive, frequency_hz: float) -> float:
        raise LimitError("drives.step_cap")

    async def scenario() -> None:
        group = GroupConfig(id="fans", drives=("fan-1", "fan-2"), leader="fan-1", ratios={"fan-2": 3.0})
        async with running_service(plant_config(groups=(group,))) as kit:
            await ready(kit)
            monkeypatch.setattr(Drive, "check_frequency", refuse)
            with pytest.raises(LimitError) as caught:
                await kit.call("group.start", group="fans", frequency_hz=20.0)
            assert caught.value.key == "plant.member_limit" and caught.value.params["why"].key == "drives.step_cap"
            assert caught.value.text("en").startswith("fan-1 in group fans: ")

    run(scenario())


def test_a_group_offers_no_frequency_above_the_cap_of_a_member_at_its_ratio() -> None:
    """It offered its lowest maximum: 50 Hz, where a follower of unknown setpoint step was capped at 0.5 Hz."""

    async def scenario() -> None:
        drives = tuple(
            replace(drive, options={"setpoint_step": "unknown"} if drive.id == "fan-2" else drive.options)
            for drive in DRIVES
        )
        group = GroupConfig(id="fans", drives=("fan-1", "fan-2"), leader="fan-1", ratios={"fan-2": 2.0})
        async with running_service(plant_config(drives=drives, groups=(group,))) as kit:
            await ready(kit)
            caps_hz = [(await kit.call("drives.get", drive=id))["setpoint_cap_hz"] for id in group.drives]
            assert caps_hz == [None, 0.5]
            (found,) = (await kit.call("groups.list"))["groups"]
            assert (found["minimum_hz"], found["maximum_hz"]) == (0.0, 0.25)
            with pytest.raises(LimitError) as caught:
                await kit.call("group.set_frequency", group="fans", frequency_hz=0.26)
            assert caught.value.key == "plant.member_limit" and caught.value.params["why"].key == "drives.step_cap"
            with pytest.raises(LimitError, match=r"fan-2 permits 0\.0 Hz to 0\.25 Hz for the group"):
                await kit.call("group.set_frequency", group="fans", frequency_hz=30.0)
            outcomes = (await kit.call("group.set_frequency", group="fans", frequency_hz=0.25))["outcomes"]
            assert outcomes["fan-2"]["status"]
            kit.service.plant.drives["fan-2"].drive.dialect.set_option("setpoint_step", "0.01")
            (found,) = (await kit.call("groups.list"))["groups"]
            assert found["maximum_hz"] == 25.0

    run(scenario())


def test_a_remote_jog_ends_half_a_second_after_its_last_renewal() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit)
            ann = remote_actor()
            await kit.call("lease.take", ann, drive="fan-1")
            with pytest.raises(ArmRequired):
                await kit.call("drive.jog", ann, drive="fan-1")
            arm = (await kit.call("drive.arm", ann, drive="fan-1"))["arm_token"]
            jog = (await kit.call("drive.jog", ann, drive="fan-1", frequency_hz=5.0, arm_token=arm))["jog"]
            for _ in range(5):
                await asyncio.sleep(0.15)
                await kit.call("drive.jog_renew", ann, drive="fan-1", jog=jog)
            await asyncio.sleep(4)
            with pytest.raises(NotFound):
                await kit.call("drive.jog_renew", ann, drive="fan-1", jog=jog)
            assert kit.station("fan-1").motor.phase is OutputPhase.OFF
            assert not kit.service.plant.drives["fan-1"].started_by_service

    run(scenario())


def test_the_end_of_a_jog_stops_the_drive() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit)
            jog = (await kit.call("drive.jog", drive="fan-1", frequency_hz=5.0))["jog"]
            found = await kit.call("drive.jog_end", drive="fan-1", jog=jog)
            assert found["outcome"]["status"] == "confirmed"
            assert LOCAL.name == kit.service.plant.leases.get("fan-1", kit.service.plant.now()).actor.name  # type: ignore[union-attr]

    run(scenario())


def test_a_jog_is_renewed_and_ended_only_under_its_own_drive() -> None:
    """Control is checked for the drive that the request names."""

    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit)
            jog = (await kit.call("drive.jog", drive="fan-1", frequency_hz=5.0))["jog"]
            for operation in ("drive.jog_renew", "drive.jog_end"):
                with pytest.raises(NotFound):
                    await kit.call(operation, drive="fan-2", jog=jog)
            assert kit.station("fan-1").running
            await kit.call("drive.jog_renew", drive="fan-1", jog=jog)

    run(scenario())


def test_a_drive_stopped_at_its_keypad_no_longer_counts_as_started_by_the_service() -> None:
    """Started there again, it runs on when the service stops."""

    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit, "fan-1")
            motor = kit.station("fan-1").motor
            motor.stop()
            await asyncio.sleep(8)
            kit.station("fan-1").motor.run(20.0)
            await asyncio.sleep(3)
            assert state(kit, "fan-1").turning
            assert await kit.service.stop() == {}

    run(scenario())


def test_a_drive_counts_as_started_while_its_standstill_may_be_older_than_the_start() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit, "fan-1")
            drive = kit.service.plant.drives["fan-1"]
            for after_s, counts in ((STANDSTILL_CONFIRM_S, True), (STANDSTILL_CONFIRM_S + 0.1, False)):
                status = replace(drive.status(), state=DriveState.STOPPED, at=drive.last_motion_at + after_s)
                report_motion(kit.service.plant, drive, status)
                assert drive.started_by_service is counts

    run(scenario())


def test_a_stopping_service_starts_nothing_also_not_the_rest_of_a_group() -> None:
    async def scenario() -> None:
        async with running_service(plant_config(groups=(GROUP,))) as kit:
            await ready(kit)
            start = asyncio.create_task(kit.call("group.start", group="fans", frequency_hz=20.0))
            await asyncio.sleep(2)
            ending = asyncio.create_task(kit.service.stop())
            await asyncio.sleep(0.1)
            with pytest.raises(ServiceUnavailable):
                await kit.call("drive.run", drive="pump-2", frequency_hz=20.0)
            await asyncio.sleep(0.1)
            assert (await kit.call("drive.stop", drive="fan-2"))["outcome"]["status"] == "confirmed"
            found = (await start)["outcomes"]
            assert [found[drive].get("status") for drive in GROUP.drives] == ["confirmed", None, None]
            assert [*(await ending)] == ["fan-1"]

    run(scenario())


def test_a_bus_that_cannot_be_opened_is_retried_and_affects_no_other() -> None:
    """It is reported once, and a stop of everything lists its drives as unconfirmed."""

    async def scenario() -> None:
        buses = (BusConfig("a", "sim://c320@1,2?name=later"), BUSES[1])
        bench = simulated_bus_of(open_port(buses[0].port))
        bench.unplug()
        async with running_service(plant_config(buses=buses)) as kit:
            await asyncio.sleep(20)
            views = {view["id"]: view["presence"] for view in (await kit.call("drives.list"))["drives"]}
            assert views == {"fan-1": "never_seen", "fan-2": "never_seen", "pump-1": "online", "pump-2": "online"}
            assert (await kit.call("buses.get", bus="a"))["problem"]["en"]
            found = await kit.call("plant.stop")
            assert found["buses"]["a"]["unconfirmed"] == ["fan-1", "fan-2"] and found["buses"]["b"]["confirmed"]
            names = Text("fan-1, fan-2", "fan-1、fan-2")
            assert kit.drives_of_events("plant.did_stop_all_but", drives=names) == [None]
            assert "port_lost" in kinds(kit)
            bench.replug()
            await asyncio.sleep(20)
            assert (await kit.call("drives.get", drive="fan-1"))["presence"] == "online"
            assert "port_lost" not in kinds(kit)
            texts = [event["text"]["en"] for event in kit.history.events]
            assert sum("can't be opened, another attempt follows" in text for text in texts) == 1
            title = {bus: bilingual_text("plant.bus", id=bus) for bus in "ab"}
            assert [len(kit.drives_of_events("plant.bus_open", bus=title[bus])) for bus in "ab"] == [1, 0]

    run(scenario())


def test_a_new_lease_clears_the_alarm_of_lost_control() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit, "fan-1")
            await asyncio.sleep(12)
            assert "control_lost" in kinds(kit)
            await kit.call("lease.take", remote_actor(), drive="fan-1")
            await asyncio.sleep(1)
            assert "control_lost" not in kinds(kit)

    run(scenario())


def test_a_history_that_cannot_be_written_raises_an_alarm_and_blocks_nothing() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit)
            kit.history.problem = Text("the disk is full", "磁盘空间已满")
            await asyncio.sleep(1)
            (alarm,) = [alarm for alarm in kit.service.plant.alarms.active() if alarm.kind == "storage_failure"]
            assert alarm.text == Text(
                "history can't be written: the disk is full; the control of drives does not depend on it",
                "历史数据无法写入：磁盘空间已满；不影响对变频器的控制",
            )
            assert (await kit.call("drive.run", drive="fan-1", frequency_hz=20.0))["outcome"]["status"] == "confirmed"
            kit.history.problem = None
            await asyncio.sleep(1)
            assert "storage_failure" not in kinds(kit)

    run(scenario())


def test_a_stopping_service_that_holds_its_drives_starts_no_more_of_them() -> None:
    """Without a stop of its drives, the state of the service ends the group's start."""

    async def scenario() -> None:
        drives = tuple(replace(drive, on_service_stop=OnServiceStop.HOLD) for drive in DRIVES)
        drives = (*drives[:3], replace(drives[3], on_service_stop=OnServiceStop.STOP))
        async with running_service(plant_config(drives=drives, groups=(GROUP,))) as kit:
            await ready(kit, "pump-2")
            start = asyncio.create_task(kit.call("group.start", group="fans", frequency_hz=20.0))
            await asyncio.sleep(2)
            pump = kit.station("pump-1")
            ending = asyncio.create_task(kit.service.stop())
            found = (await start)["outcomes"]
            assert [found[drive].get("code") for drive in GROUP.drives] == [None, "plant.stopping", "plant.stopping"]
            assert [*(await ending)] == ["pump-2"] and pump.motor.starts == 0
            held = [event["drive"] for event in kit.history.events if "on_service_stop = hold" in event["text"]["en"]]
            assert held == [GROUP.drives[0]]

    run(scenario())


def test_a_stopping_service_does_not_wait_for_a_long_ramp() -> None:
    """It reports the stop as unknown within three seconds; the drive goes on slowing down."""

    async def scenario() -> None:
        buses = (replace(BUSES[0], port="sim://c320@1,2?ramp=30"), BUSES[1])
        async with running_service(plant_config(buses=buses)) as kit:
            await ready(kit, "fan-1")
            await asyncio.sleep(15)
            started_at = kit.service.plant.now()
            assert await kit.service.stop() == {"fan-1": None}
            assert kit.service.plant.now() - started_at <= 3.0

    run(scenario())


def test_the_last_stop_of_a_drive_names_its_user_and_kind_until_the_drive_is_started_again() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(2)
            await kit.grant_waivers()
            ann = remote_actor("ann")

            async def last_stop(drive: str = "fan-1") -> tuple[str, str] | None:
                found = (await kit.call("drives.get", drive=drive))["last_stop"]
                return None if found is None else (found["kind"], found["actor"])

            assert await last_stop() is None
            await kit.call("drive.stop", ann, drive="fan-1")
            assert await last_stop() == ("drive", "ann")
            await kit.call("drive.run", drive="fan-1", frequency_hz=20.0)
            assert await last_stop() is None, "it was started again"
            await kit.call("group.stop", ann, group="fans")
            assert (await last_stop(), await last_stop("fan-2")) == (("group", "ann"), ("group", "ann"))
            await kit.call("plant.stop", remote_actor("bob"))
            assert await last_stop("pump-1") == ("all", "bob")

    run(scenario())
