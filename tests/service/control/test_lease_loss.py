"""Ends without a command: a lost jog revokes arm tokens; a lost lease is handled also while the drive is offline."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from math import inf

import pytest

from drivebus import i18n
from drivebus.drives.state import DriveState
from drivebus.errors import ArmRequired, ControlNotHeld, NotFound, Superseded
from drivebus.service.alarms import SystemAlarm
from drivebus.service.auth.rights import Role
from drivebus.service.config.model import OnClientLost
from drivebus.service.runtime.drive_reports import report_motion
from drivebus.simulator.motor import OutputPhase
from drivebus.simulator.port import simulated_bus_of
from drivebus.testing.virtual_time import run
from drivebus.types import Json
from drivebus.values import Text
from fixtures.service import BUSES, DRIVES, plant_config, remote_actor, running_service

ANN = remote_actor()


@pytest.mark.parametrize("lost", [True, False])
def test_the_end_of_a_jog_revokes_earlier_arm_tokens(lost: bool) -> None:
    """Both the end and the expiry of a jog are stops."""

    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(2)
            await kit.grant_waivers()
            await kit.call("lease.take", ANN, drive="fan-1")
            first, second = [(await kit.call("drive.arm", ANN, drive="fan-1"))["arm_token"] for _ in range(2)]
            jog = (await kit.call("drive.jog", ANN, drive="fan-1", frequency_hz=5.0, arm_token=first))["jog"]
            if lost:
                await asyncio.sleep(2)
            else:
                await kit.call("drive.jog_end", ANN, drive="fan-1", jog=jog)
            assert kit.drives_of_events("plant.jog_lost") == ["fan-1"] * lost
            starts = kit.station("fan-1").motor.starts
            with pytest.raises(ArmRequired):
                await kit.call("drive.run", ANN, drive="fan-1", frequency_hz=20.0, arm_token=second)
            assert kit.station("fan-1").motor.starts == starts

    run(scenario())


def test_a_session_that_ends_while_it_takes_control_gets_none() -> None:
    """The lease was there for ten seconds, of a session that could not renew it."""

    async def scenario() -> None:
        async with running_service() as kit:
            kit.trail.delay_s = 0.5
            taking = asyncio.create_task(kit.call("lease.take", ANN, drive="fan-1"))
            await asyncio.sleep(0.1)
            await kit.service.end_control("logout", ANN)
            with pytest.raises(ControlNotHeld) as rejected:
                await taking
            assert rejected.value.key == "plant.session_has_ended"

    run(scenario())


def test_a_jog_that_is_being_started_while_its_session_ends_is_stopped_at_once() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            jog = await kit.begin(ANN, "drive.jog", "fan-1", 5.0)
            while kit.station("fan-1").motor.starts == 0:  # noqa: ASYNC110  the simulated drive has no event
                await asyncio.sleep(0.001)
            assert not jog.done()
            await kit.service.end_control("logout", ANN)
            await jog
            assert kit.drives_of_events("plant.jog_ended_with_session", actor="ann") == ["fan-1"]
            await asyncio.sleep(0.3)
            assert not kit.station("fan-1").running, "it was stopped only after the 0.5 s without a renewal"

    run(scenario())


def test_a_session_that_ends_while_it_asks_for_control_leaves_no_request() -> None:
    """It could be granted for a minute: the drive ran on under the control of nobody."""
    bob = remote_actor("bob")

    async def scenario() -> None:
        async with running_service() as kit:
            await kit.call("lease.take", ANN, drive="fan-1")
            kit.trail.delay_s = 0.5
            asking = asyncio.create_task(kit.call("control_request.make", bob, drive="fan-1"))
            await asyncio.sleep(0.1)
            await kit.service.end_control("logout", bob)
            with pytest.raises(ControlNotHeld) as rejected:
                await asking
            assert rejected.value.key == "plant.session_has_ended"
            assert kit.service.plant.control_requests.find_open("fan-1") is None

    run(scenario())


def test_a_request_for_control_of_a_session_that_ended_can_not_be_granted() -> None:
    bob = remote_actor("bob")

    async def scenario() -> None:
        async with running_service() as kit:
            await kit.call("lease.take", ANN, drive="fan-1")
            request = (await kit.call("control_request.make", bob, drive="fan-1"))["control_request"]
            await kit.service.end_control("logout", bob)
            with pytest.raises(NotFound):
                await kit.call("control_request.grant", ANN, drive="fan-1", request=request["id"])
            lease = kit.service.plant.leases.get("fan-1", kit.service.plant.now())
            assert lease is not None and lease.actor == ANN

    run(scenario())


@pytest.mark.parametrize("renewed", [True, False])
def test_a_jog_that_another_user_has_stopped_is_not_renewed_and_its_expiry_does_not_hide_that_stop(
    renewed: bool,
) -> None:
    """Renewals were answered as if the motor turned on; then the stop was shown as the end of the jog."""

    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(2)
            await kit.grant_waivers()
            await kit.call("lease.take", ANN, drive="fan-1")
            token = (await kit.call("drive.arm", ANN, drive="fan-1"))["arm_token"]
            jog = (await kit.call("drive.jog", ANN, drive="fan-1", frequency_hz=5.0, arm_token=token))["jog"]
            stop = asyncio.create_task(kit.call("drive.stop", remote_actor("bob"), drive="fan-1"))
            await asyncio.sleep(0.2)
            if renewed:
                with pytest.raises(Superseded):
                    await kit.call("drive.jog_renew", ANN, drive="fan-1", jog=jog)
            await stop
            await asyncio.sleep(2)
            last_stop = kit.service.plant.drives["fan-1"].last_stop
            assert last_stop is not None and (last_stop.kind, last_stop.actor) == ("drive", "bob")
            assert kit.drives_of_events("plant.jog_lost", actor="ann") == []
            with pytest.raises(NotFound):
                await kit.call("drive.jog_renew", ANN, drive="fan-1", jog=jog)

    run(scenario())


@pytest.mark.parametrize("taken", [True, False])
def test_a_jog_ends_when_another_session_takes_control(taken: bool) -> None:
    """The owner of the jog goes on to renew it. Control that has merely ended is nobody's, and the jog goes on."""
    engineer = remote_actor("li", Role.ENGINEER)

    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(2)
            await kit.grant_waivers()
            await kit.call("lease.take", ANN, drive="fan-1")
            arm = (await kit.call("drive.arm", ANN, drive="fan-1"))["arm_token"]
            jog = (await kit.call("drive.jog", ANN, drive="fan-1", frequency_hz=5.0, arm_token=arm))["jog"]
            if taken:
                await kit.call("lease.take", engineer, drive="fan-1")
            refused = 0
            for _ in range(60):
                await asyncio.sleep(0.2)
                try:
                    await kit.call("drive.jog_renew", ANN, drive="fan-1", jog=jog)
                except (ControlNotHeld, NotFound):
                    refused += 1
            assert (refused > 0, kit.station("fan-1").motor.phase is OutputPhase.OFF) == (taken, taken)

    run(scenario())


@pytest.mark.parametrize("started", [False, True], ids=["before its frame", "while it turns"])
@pytest.mark.parametrize("how", ["taken", "handed over"])
def test_the_stop_of_a_jog_precedes_every_command_of_the_session_that_takes_control(how: str, started: bool) -> None:
    """It came up to half a second later and stopped what the new session had started by then."""
    engineer = remote_actor("li", Role.ENGINEER)

    async def scenario() -> None:
        async with running_service() as kit:
            jogging = await kit.begin(ANN, "drive.jog", "fan-1", 5.0)
            motor = kit.station("fan-1").motor
            if started:
                await jogging
            else:
                while motor.starts == 0:  # noqa: ASYNC110  the simulated drive has no event
                    await asyncio.sleep(0.001)
                assert not jogging.done()
            if how == "taken":
                await kit.call("lease.take", engineer, drive="fan-1")
            else:
                made = await kit.call("control_request.make", engineer, drive="fan-1")
                request = made["control_request"]["id"]
                await kit.call("control_request.grant", ANN, drive="fan-1", request=request)
            await jogging
            assert kit.drives_of_events("plant.jog_taken_over", actor="ann") == ["fan-1"]
            await asyncio.sleep(0.2)
            assert not kit.station("fan-1").running, "it was stopped only after the 0.5 s without a renewal"
            await asyncio.sleep(2)
            arm = (await kit.call("drive.arm", engineer, drive="fan-1"))["arm_token"]
            await kit.call("drive.run", engineer, drive="fan-1", frequency_hz=20.0, arm_token=arm)
            await asyncio.sleep(2)
            assert kit.station("fan-1").running
            assert kit.drives_of_events("plant.jog_lost") == []

    run(scenario())


MAY_BE_RUNNING = [
    {
        "en": "Fan 1 may be running, and the session that had control is lost",
        "zh": "风机 1 可能仍在运行，而持有控制权的会话已失效",
    }
]


@pytest.mark.parametrize("silent", [True, False])
@pytest.mark.parametrize("policy", list(OnClientLost))
def test_a_lost_lease_is_handled_unless_the_drive_reports_standstill(policy: OnClientLost, silent: bool) -> None:
    """An offline drive may be running although this service did not start it."""

    async def scenario() -> None:
        drives = tuple(replace(drive, on_client_lost=policy) for drive in DRIVES)
        async with running_service(plant_config(drives=drives)) as kit:
            await asyncio.sleep(2)
            await kit.call("lease.take", ANN, drive="fan-1")
            drive = kit.service.plant.drives["fan-1"]
            if silent:
                simulated_bus_of(drive.bus.port).unplug()
            await asyncio.sleep(15)
            assert drive.status().state is (DriveState.UNKNOWN if silent else DriveState.STOPPED)
            lost = [alarm for alarm in kit.service.plant.alarms.active() if alarm.kind == SystemAlarm.CONTROL_LOST]
            assert [alarm.text.by_language() for alarm in lost] == MAY_BE_RUNNING * (
                silent and policy is OnClientLost.HOLD
            )
            stops = [entry.what for entry in kit.trail.entries if entry.who == "drivebus"]
            assert stops == (["drive.stop"] * 2 if silent and policy is OnClientLost.STOP else [])

    run(scenario())


def test_a_standstill_that_was_read_before_a_start_frame_does_not_end_the_alarm_of_lost_control() -> None:
    """The session ended during its start: the motor then ran without control and without an alarm."""

    async def scenario() -> None:
        async with running_service(plant_config()) as kit:
            await asyncio.sleep(2)
            await kit.grant_waivers()
            plant = kit.service.plant
            await kit.call("lease.take", ANN, drive="fan-1")
            arm = (await kit.call("drive.arm", ANN, drive="fan-1"))["arm_token"]
            run_call = kit.call("drive.run", ANN, drive="fan-1", frequency_hz=20.0, arm_token=arm)
            starting = asyncio.create_task(run_call)
            while kit.station("fan-1").motor.starts == 0:  # noqa: ASYNC110  the simulated drive has no event
                await asyncio.sleep(0.001)
            assert plant.drives["fan-1"].last_motion_at == inf
            assert plant.drives["fan-1"].status().state is DriveState.STOPPED, "the case is not played"
            kit.service.policies.end_control(ANN.session, "rights")
            report_motion(plant, plant.drives["fan-1"], plant.drives["fan-1"].status())
            assert [alarm.kind for alarm in plant.alarms.active()] == [SystemAlarm.CONTROL_LOST]
            await starting
            assert [alarm.kind for alarm in plant.alarms.active() if alarm.cleared_ms is None] == [
                SystemAlarm.CONTROL_LOST
            ]

    run(scenario())


def test_the_end_of_a_port_alarm_is_not_attributed_to_who_acknowledged_it() -> None:
    """Alarm and events name the bus by its title."""
    events: list[Json] = []
    alarms: list[str] = []
    buses = tuple(replace(bus, title=Text(f"Line {bus.id}", f"线路 {bus.id}")) for bus in BUSES)

    async def scenario() -> None:
        async with running_service(plant_config(buses=buses)) as kit:
            await asyncio.sleep(2)
            plant = kit.service.plant
            port = kit.simulated_bus("fan-1")
            port.unplug()
            await asyncio.sleep(2)
            (alarm,) = [alarm for alarm in plant.alarms.active() if alarm.kind == SystemAlarm.PORT_LOST]
            alarms.extend(alarm.text.by_language().values())
            plant.publish_alarms(plant.alarms.acknowledge(alarm.id, "ann", plant.wall_ms()))
            port.replug()
            await asyncio.sleep(3)
            events.extend(kit.history.events)

    run(scenario())
    outcomes = [(event["outcome"], event["actor"]) for event in events]
    assert [(outcome, actor) for outcome, actor in outcomes if actor == "ann"] == [("acknowledged", "ann")]
    assert ("cleared", None) in outcomes
    lost, opened = [event["text"] for event in events if event["kind"] == "presence" and event["drive"] is None]
    assert lost == {
        "en": "Line a has lost its port; it is opened again as soon as possible",
        "zh": "线路 a 的端口断开；将尽快重新打开",
    }
    assert opened == {"en": "Line a is open", "zh": "线路 a 已打开"}
    reopened = Text.per_language(lambda language: i18n.text("plant.bus_reopened", language))
    assert alarms == [f"Line a has lost its port: {reopened.en}", f"线路 a 的端口断开：{reopened.zh}"]


@pytest.mark.parametrize("title", ["", "a"])
def test_a_port_lost_in_the_first_second_of_the_service_raises_its_alarm(title: str) -> None:
    """Only the loss of a port that a supervision cycle had found open was reported.

    A plant file without titles gives each bus its id as its title.
    """
    buses = tuple(replace(bus, title=Text(title, title)) if bus.id == "a" else bus for bus in BUSES)

    async def scenario() -> None:
        async with running_service(plant_config(buses=buses)) as kit:
            plant = kit.service.plant
            bus = plant.buses["a"]
            await asyncio.sleep(0.01)
            assert bus.bus.is_open
            simulated_bus_of(bus.bus.port).unplug()
            assert bus.reported_open is None, "a supervision cycle has seen the open port: the case is not played"
            await asyncio.sleep(3)
            (alarm,) = [alarm for alarm in plant.alarms.active() if alarm.kind == SystemAlarm.PORT_LOST]
            assert (alarm.subject, alarm.cleared_ms) == ("a", None)
            (lost,) = [event["text"] for event in kit.history.events if event["kind"] == "presence"]
            assert lost["en"] == "bus a has lost its port; it is opened again as soon as possible"
            assert lost["zh"] == "总线 a 的端口断开；将尽快重新打开"
            simulated_bus_of(bus.bus.port).replug()
            await asyncio.sleep(3)
            assert plant.alarms.active()[0].cleared_ms is not None
            assert "bus a is open" in [event["text"]["en"] for event in kit.history.events]

    run(scenario())
