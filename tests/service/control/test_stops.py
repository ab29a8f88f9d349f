"""Stops: they need no lease, arm token or audit trail, cancel earlier commands, and report their result."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from dataclasses import replace
from functools import partial

import pytest

from drivebus import i18n
from drivebus.drives.drive import Drive
from drivebus.drives.state import DriveState
from drivebus.errors import (
    ArmRequired,
    AuditUnavailable,
    DrivebusError,
    LimitError,
    StartInhibited,
    StopUnconfirmed,
    Superseded,
)
from drivebus.ports import open_port
from drivebus.service.audit.description import described
from drivebus.service.audit.records import entry_json
from drivebus.service.auth.rights import Role
from drivebus.service.config.model import BusConfig, DriveConfig, GroupConfig, OnClientLost, PlantConfig
from drivebus.simulator.motor import OutputPhase
from drivebus.simulator.port import simulated_bus_of
from drivebus.testing.virtual_time import run
from drivebus.values import Text, bilingual_text
from fixtures.drives import SimulatedDrives
from fixtures.service import (
    BUSES,
    DRIVES,
    ServiceKit,
    blocked,
    commanded_hz,
    plant_config,
    ready,
    remote_actor,
    running_service,
)


def kinds(kit: ServiceKit) -> set[str]:
    return {alarm.kind for alarm in kit.service.plant.alarms.active() if alarm.cleared_ms is None}


def state(kit: ServiceKit, drive: str) -> DriveState:
    return kit.service.plant.drives[drive].status().state


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
            shown = {
                bus: (result["confirmed"], result["acknowledged"], result["unconfirmed"])
                for bus, result in buses.items()
            }
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
            return str(kit.event_texts()[-1])

    empty, whole = run(scenario(plant_config(drives=(), groups=()))), run(scenario(plant_config()))
    assert empty == i18n.text("plant.did_stop_all_no_drives", "en")
    assert whole == i18n.text("plant.did_stop_all", "en")


def test_a_lost_bus_is_reported_as_unconfirmed_and_the_others_are_stopped() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit, "fan-1", "pump-1")
            kit.simulated_bus("fan-1").unplug()
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
            bench = kit.simulated_bus("fan-1")
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
            bench = kit.simulated_bus("fan-1")
            bench.unplug()
            await asyncio.sleep(6)
            with pytest.raises(StopUnconfirmed) as caught:
                await kit.call("drive.stop", drive="fan-1")
            assert caught.value.key == "plant.stop_not_sent_port"
            assert "STOP NOT SENT: the port is not open" in str(caught.value)
            assert "The service sends it when the port is open again" in str(caught.value)
            ended = described([entry_json(entry, 0) for entry in kit.trail.entries if entry.what == "drive.stop"][-1])
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


@pytest.mark.parametrize("stop", ["drive.stop", "plant.stop", "group.stop"])
def test_a_stop_that_was_not_sent_has_a_second_outcome_once_it_was_repeated_and_confirmed(stop: str) -> None:
    """The trail had no record of it but that it was not sent."""

    async def scenario() -> None:
        async with running_service(plant_config(groups=(GroupConfig(id="fans", drives=("fan-1",)),))) as kit:
            await ready(kit, "fan-1")
            bench = kit.simulated_bus("fan-1")
            bench.unplug()
            await asyncio.sleep(6)
            kit.trail.entries.clear()
            target = {"drive.stop": {"drive": "fan-1"}, "group.stop": {"group": "fans"}}.get(stop, {})
            with suppress(StopUnconfirmed):
                await kit.call(stop, remote_actor("ann"), **target)
            await asyncio.sleep(10)
            assert kit.trail.outcomes(stop)[0] == "requested" and len(kit.trail.entries) == 2
            stopped = len(kit.history.events)
            bench.replug()
            await asyncio.sleep(6)
            assert kit.station("fan-1").motor.phase is OutputPhase.OFF
            # one record, also of a stop that was repeated many times
            (repeated,) = (entry for entry in kit.trail.entries[2:] if entry.target == "fan-1")
            assert (repeated.what, repeated.who, repeated.target) == ("drive.stop", "drivebus", "fan-1")
            assert (repeated.outcome, repeated.of) == ("confirmed", 1)
            assert repeated.frames and repeated.params == {"requested_by": "ann"}
            assert described(entry_json(repeated, 0))["text"] == {
                "en": "Bus stop of fan-1: repeated until the drive confirmed it, requested by ann",
                "zh": "停止 fan-1（总线停止）：重复发送直至变频器确认，由 ann 请求",
            }
            events = [event["text"]["en"] for event in kit.history.events[stopped:] if event["drive"] == "fan-1"]
            assert len([text for text in events if text.startswith("stop: ")]) == 1, events

    run(scenario())


@pytest.mark.parametrize(("delay_s", "key"), [(0.06, "plant.stop_port_lost"), (0.5, "plant.stop_port_lost_after")])
def test_a_port_lost_during_a_stop_is_reported_with_its_repetition_by_the_service(delay_s: float, key: str) -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit, "fan-1")
            bench = kit.simulated_bus("fan-1")
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
    """The repetition of the stop ends at once, because no port is opened again."""

    async def scenario() -> None:
        async with running_service(plant_config(buses=(BusConfig("a", "/nonexistent/tty"), BUSES[1]))) as kit:
            with pytest.raises(StopUnconfirmed) as caught:
                await kit.call("drive.stop", drive="fan-1")
            assert caught.value.key == "drives.stop_not_sent_port"

    run(scenario())


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


async def test_a_stop_that_is_under_way_when_its_drive_leaves_the_bus_ends_without_an_internal_error() -> None:
    async with SimulatedDrives("c320") as bench:
        drive = Drive(bench.bus, "c320", 1)
        stop = asyncio.create_task(drive.stop())
        await asyncio.sleep(0.005)
        assert drive.stopping
        drive.close()
        with pytest.raises(DrivebusError):
            await stop


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


def test_a_stop_is_confirmed_while_many_requests_read_parameters_of_its_bus() -> None:
    """Ten requests at once went before the reads that confirm it: it was reported as not confirmed."""

    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit, "fan-2")
            names = [*kit.service.plant.drives["fan-1"].profile.parameters][:64]
            call = partial(kit.call, "parameters.read", drive="fan-1", names=names)
            reads = [asyncio.create_task(call()) for _ in range(10)]
            await asyncio.sleep(0.5)
            stopped = await kit.call("drive.stop", drive="fan-2")
            assert stopped["outcome"]["status"] == "confirmed"
            for read in reads:
                assert len((await read)["parameters"]) == len(names)

    run(scenario())
