"""Reload of a changed plant.toml: only differences are applied; what did not change misses no poll."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from drivebus.errors import (
    ArmRequired,
    ConfigurationError,
    ControlNotHeld,
    DrivebusError,
    NotFound,
    ServiceError,
    StartInhibited,
    StopUnconfirmed,
    Superseded,
)
from drivebus.service.alarms import SystemAlarm
from drivebus.service.config.load import load
from drivebus.service.runtime.drive import DriveRuntime
from drivebus.service.runtime.plant import GatewayStatus
from drivebus.simulator.port import simulated_bus_of
from drivebus.testing.virtual_time import run
from fixtures.service import ServiceKit, remote_actor, running_service

HEAD = """
format = 1
[plant]
id = "hall"
title = "Hall"
[bus.a]
port = "sim://c320@1-3?ramp=2&name=a"
[bus.b]
port = "sim://vc660@1-2?ramp=2&name=b"
"""
FAN_1 = '[drive.fan-1]\nbus = "a"\naddress = 1\nmodel = "c320"\n'
FAN_2 = '[drive.fan-2]\nbus = "a"\naddress = 2\nmodel = "c320"\n'
FAN_3 = '[drive.fan-3]\nbus = "a"\naddress = 3\nmodel = "c320"\n'
PUMP = '[drive.pump-1]\nbus = "b"\naddress = 1\nmodel = "vc660"\n'


def write(path: Path, *parts: str, head: str = HEAD) -> Path:
    path.write_text(head + "".join(parts))
    return path


def polls(kit: ServiceKit, drive: str) -> int:
    runtime = kit.service.plant.drives[drive]
    return runtime.bus.statistics().stations[runtime.config.address].transactions


def uncleared_alarms(kit: ServiceKit) -> set[tuple[str, str, str]]:
    active = kit.service.plant.alarms.active()
    return {(alarm.kind, alarm.drive, alarm.subject) for alarm in active if alarm.cleared_ms is None}


def test_untouched_drives_miss_no_poll(tmp_path: Path) -> None:
    """Twenty seconds with a reload have as many polls as twenty seconds without."""
    file = write(tmp_path / "plant.toml", FAN_1, FAN_2, PUMP)

    async def poll_counts(reload: bool) -> dict[str, int]:
        async with running_service(load(file)) as kit:
            await asyncio.sleep(10)
            before = {drive: polls(kit, drive) for drive in ("fan-1", "pump-1")}
            await asyncio.sleep(10)
            if reload:
                await kit.call("configuration.reload")
            await asyncio.sleep(10)
            return {drive: polls(kit, drive) - count for drive, count in before.items()}

    without_reload = run(poll_counts(False))
    with_reload = run(poll_counts(True))
    write(file, FAN_1, FAN_2, PUMP)
    assert with_reload == without_reload

    async def scenario() -> None:
        async with running_service(load(file)) as kit:
            await asyncio.sleep(10)
            bus = kit.service.plant.buses["b"]
            drive, monitor = kit.service.plant.drives["pump-1"], kit.service.plant.drives["pump-1"].monitor
            before = polls(kit, "pump-1")
            await asyncio.sleep(10)
            write(file, FAN_1, FAN_3, PUMP)
            kit.history.events.clear()
            found = await kit.call("configuration.reload")
            assert [event["text"]["en"] for event in kit.history.events] == ["the configuration was reloaded"]
            assert found["difference"] == {"added": ["fan-3"], "changed": [], "removed": ["fan-2"]}
            await asyncio.sleep(10)
            assert polls(kit, "pump-1") - before == without_reload["pump-1"]
            assert kit.service.plant.buses["b"] is bus
            assert kit.service.plant.drives["pump-1"] is drive and drive.monitor is monitor
            views = {view["id"]: view for view in (await kit.call("drives.list"))["drives"]}
            assert list(views) == ["fan-1", "fan-3", "pump-1"]
            assert views["fan-3"]["presence"] == "online"
            with pytest.raises(NotFound):
                await kit.call("drives.get", drive="fan-2")

    run(scenario())


def test_changed_limits_and_periods_apply_to_the_running_drive(tmp_path: Path) -> None:
    file = write(tmp_path / "plant.toml", FAN_1, PUMP)

    async def scenario() -> None:
        async with running_service(load(file)) as kit:
            await asyncio.sleep(5)
            drive = kit.service.plant.drives["fan-1"]
            limits = "[drive.fan-1.limits]\nmaximum_hz = 30.0\n"
            write(file, FAN_1, limits, "[drive.fan-1.signals]\noutput_frequency = 0.2\n", PUMP)
            await kit.call("configuration.reload")
            assert kit.service.plant.drives["fan-1"] is drive
            assert (await kit.call("drives.get", drive="fan-1"))["maximum_hz"] == 30.0
            before = polls(kit, "fan-1")
            await asyncio.sleep(10)
            assert polls(kit, "fan-1") - before >= 45

    run(scenario())


def test_the_values_of_a_drive_and_of_a_signal_that_a_reload_removes_end_with_a_gap(tmp_path: Path) -> None:
    """In a chart and a file the last values would seem to hold until the next ones, if ever these are read again."""
    file = write(tmp_path / "plant.toml", FAN_1, FAN_2)

    async def scenario() -> None:
        async with running_service(load(file)) as kit:
            await asyncio.sleep(10)
            write(file, FAN_1, "[drive.fan-1.signals]\noutput_frequency = 1.0\n")
            before = len(kit.history.samples)
            await kit.call("configuration.reload")
            await asyncio.sleep(10)
            ended = {sample.tag for sample in kit.history.samples[before:] if sample.value is None}
            assert {"fan-1.output_voltage", "fan-2.output_voltage", "fan-2.output_frequency"} <= ended

    run(scenario())


def test_a_running_drive_is_not_removed_from_its_bus(tmp_path: Path) -> None:
    file = write(tmp_path / "plant.toml", FAN_1, FAN_2, PUMP)

    async def scenario() -> None:
        async with running_service(load(file)) as kit:
            await asyncio.sleep(5)
            await kit.grant_waivers()
            await kit.call("drive.run", drive="fan-2", frequency_hz=20.0)
            write(file, FAN_1, PUMP)
            with pytest.raises(DrivebusError, match="fan-2"):
                await kit.call("configuration.reload")
            assert "fan-2" in kit.service.plant.drives
            await kit.call("drive.stop", drive="fan-2")
            await asyncio.sleep(1)
            await kit.call("configuration.reload")
            assert "fan-2" not in kit.service.plant.drives

    run(scenario())


def test_a_start_inhibit_survives_a_change_of_the_bus(tmp_path: Path) -> None:
    """An edited file does not release what a person stopped."""
    file = write(tmp_path / "plant.toml", FAN_1, PUMP)

    async def scenario() -> None:
        async with running_service(load(file)) as kit:
            await asyncio.sleep(5)
            await kit.grant_waivers()
            await kit.call("plant.stop")
            write(file, FAN_1, PUMP, head=HEAD.replace("ramp=2&name=a", "ramp=3&name=other"))
            await kit.call("configuration.reload")
            await asyncio.sleep(5)
            with pytest.raises(StartInhibited) as rejected:
                await kit.call("drive.run", drive="fan-1", frequency_hz=20.0)
            assert rejected.value.key == "drives.start_inhibited"

    run(scenario())


def test_a_reload_says_where_the_page_is_found_that_it_moves(tmp_path: Path) -> None:
    file = write(tmp_path / "plant.toml", FAN_1)

    async def scenario() -> None:
        async with running_service(load(file)) as kit:
            kit.service.plant.gateways["web"] = GatewayStatus(id="web")
            assert (await kit.call("configuration.reload"))["notes"] == []
            write(file, FAN_1, "[gateway.web]\nport = 9090\n")
            (note,) = (await kit.call("configuration.reload"))["notes"]
            assert note["en"].endswith("starts it at http://127.0.0.1:9090: open it there.")
            assert (await kit.call("configuration.reload"))["notes"] == [], "it is there now"

    run(scenario())


def test_a_wrong_file_changes_nothing_and_every_mistake_is_reported(tmp_path: Path) -> None:
    file = write(tmp_path / "plant.toml", FAN_1, PUMP)

    async def scenario() -> None:
        async with running_service(load(file)) as kit:
            await asyncio.sleep(5)
            wrong = HEAD + FAN_1 + PUMP.replace("vc660", "nonsense") + FAN_2.replace('"a"', '"nowhere"')
            write(file, wrong, head="")
            with pytest.raises(ConfigurationError):
                await kit.call("configuration.reload")
            assert [*kit.service.plant.drives] == ["fan-1", "pump-1"]
            assert (await kit.call("configuration.get"))["text"] == wrong

    run(scenario())


def test_a_drive_that_is_removed_during_a_stop_of_everything_is_in_its_result(tmp_path: Path) -> None:
    file = write(tmp_path / "plant.toml", FAN_1, FAN_2, PUMP)

    async def scenario() -> None:
        async with running_service(load(file)) as kit:
            await asyncio.sleep(5)
            write(file, FAN_1, PUMP)
            stop = asyncio.create_task(kit.call("plant.stop"))
            await asyncio.sleep(0.02)
            await kit.call("configuration.reload")
            found = await stop
            assert {*found["outcomes"]} == {"fan-1", "fan-2", "pump-1"}
            assert [*kit.service.plant.drives] == ["fan-1", "pump-1"]

    run(scenario())


@pytest.mark.parametrize("stopped", [True, False])
@pytest.mark.parametrize("operation", ["drive.run", "group.start"])
def test_a_start_requested_before_its_drive_was_replaced_is_not_sent(
    tmp_path: Path, operation: str, stopped: bool
) -> None:
    """A stop counts for the drive's id, also after a replacement; a start was meant for the drive replaced."""
    group = '[group.fans]\ndrives = ["fan-1", "fan-2"]\n'
    file = write(tmp_path / "plant.toml", FAN_1, FAN_2, PUMP, group)

    async def scenario() -> None:
        async with running_service(load(file)) as kit:
            await asyncio.sleep(3)
            await kit.grant_waivers()
            kit.trail.delay_s = 1.0
            target = {"drive": "fan-1"} if operation == "drive.run" else {"group": "fans"}
            start = asyncio.create_task(kit.call(operation, frequency_hz=20.0, **target))
            await asyncio.sleep(0.1)
            kit.trail.delay_s = 0.0
            if stopped:
                await kit.call("drive.stop", drive="fan-1")
            write(file, FAN_1.replace("address = 1", "address = 3"), FAN_2, PUMP, group)
            await kit.call("configuration.reload")
            with pytest.raises(Superseded) as rejected:
                await start
            assert rejected.value.key == ("plant.stopped_meanwhile" if stopped else "plant.another_meanwhile")
            assert rejected.value.params["drive"] == "fan-1"

    run(scenario())


MOVED = (FAN_1.replace("address = 1", "address = 3"), FAN_2)
TWO_FANS = '[group.fans]\ndrives = ["fan-1", "fan-2"]\n'
THREE_FANS = '[group.fans]\ndrives = ["fan-1", "fan-2", "fan-3"]\n'


@pytest.mark.parametrize(
    ("operation", "after"),
    [
        ("drive.run", (*MOVED, TWO_FANS)),
        ("group.start", (*MOVED, TWO_FANS)),
        ("group.start", (FAN_1, FAN_2, FAN_3, THREE_FANS)),
    ],
    ids=["drive", "member", "group"],
)
def test_a_start_armed_before_its_drive_or_group_was_replaced_has_to_be_armed_again(
    tmp_path: Path, operation: str, after: tuple[str, ...]
) -> None:
    """The name is the same, but another motor would start."""
    file = write(tmp_path / "plant.toml", FAN_1, FAN_2, TWO_FANS)
    ann, target = remote_actor(), {"drive": "fan-1"} if operation == "drive.run" else {"group": "fans"}
    arming = "drive.arm" if operation == "drive.run" else "group.arm"

    async def take_control(kit: ServiceKit) -> None:
        await asyncio.sleep(3)
        await kit.grant_waivers()
        for drive in kit.service.plant.drives:
            await kit.call("lease.take", ann, drive=drive)

    async def scenario() -> None:
        async with running_service(load(file)) as kit:
            await take_control(kit)
            armed = await kit.call(arming, ann, **target)
            write(file, *after)
            await kit.call("configuration.reload")
            await take_control(kit)
            with pytest.raises(ArmRequired) as rejected:
                await kit.call(operation, ann, **target, frequency_hz=20.0, arm_token=armed["arm_token"])
            assert rejected.value.key == "plant.arm_void"
            armed = await kit.call(arming, ann, **target)
            await kit.call(operation, ann, **target, frequency_hz=20.0, arm_token=armed["arm_token"])

    run(scenario())


@pytest.mark.parametrize("after", [MOVED, (FAN_2,)], ids=["replaced", "removed"])
def test_control_of_a_drive_ends_where_a_reload_gives_its_name_to_another_motor(
    tmp_path: Path, after: tuple[str, ...]
) -> None:
    """The session would set the frequency of a motor that it never took control of."""
    file = write(tmp_path / "plant.toml", FAN_1, FAN_2)
    ann = remote_actor()

    async def scenario() -> None:
        async with running_service(load(file)) as kit:
            for drive in ("fan-1", "fan-2"):
                await kit.call("lease.take", ann, drive=drive)
            write(file, *after)
            await kit.call("configuration.reload")
            plant = kit.service.plant
            assert [plant.leases.get(id, plant.now()) is not None for id in ("fan-1", "fan-2")] == [False, True]
            assert kit.drives_of_events("plant.control_ended_by_reload", owner=ann.name) == ["fan-1"]
            if after is MOVED:
                with pytest.raises(ControlNotHeld):
                    await kit.call("drive.set_frequency", ann, drive="fan-1", frequency_hz=20.0)

    run(scenario())


def test_an_interlock_does_not_hold_by_the_last_view_of_a_replaced_drive(tmp_path: Path) -> None:
    """Another motor could start for as long as no supervision cycle had looked at the new one."""
    interlock = '[interlock.flow]\ndrives = ["fan-1"]\nrequire = "fan-2.state == stopped"\n'
    file = write(tmp_path / "plant.toml", FAN_1, FAN_2, interlock)

    async def scenario() -> None:
        async with running_service(load(file)) as kit:
            plant = kit.service.plant

            def unmet() -> list[str]:
                return [violation.config.id for violation in plant.interlocks.violations("fan-1")]

            await asyncio.sleep(5)
            assert unmet() == [] and plant.views["fan-2"].state == "stopped"
            write(file, FAN_1, FAN_2.replace("address = 2", "address = 3"), interlock)
            await kit.call("configuration.reload")
            assert unmet() == ["flow"]
            plant.interlocks.evaluate(plant.views, plant.now())  # the end of a cycle that began before the reload
            assert unmet() == ["flow"]
            await asyncio.sleep(5)
            assert unmet() == []

    run(scenario())


@pytest.mark.parametrize("rest", [(), (FAN_3.replace("c320", "c300"),)], ids=["gone", "replaced"])
def test_a_group_start_ends_where_a_drive_was_removed_from_the_group(tmp_path: Path, rest: tuple[str, ...]) -> None:
    group = '[group.fans]\ndrives = ["fan-1", "fan-2", "fan-3"]\nstart_interval_s = 4.0\n'
    file = write(tmp_path / "plant.toml", FAN_1, FAN_2, FAN_3, PUMP, group)

    async def scenario() -> None:
        async with running_service(load(file)) as kit:
            await asyncio.sleep(3)
            await kit.grant_waivers()
            start = asyncio.create_task(kit.call("group.start", group="fans", frequency_hz=20.0))
            await asyncio.sleep(3)
            station = kit.station("fan-2")
            write(file, FAN_1, FAN_2, *rest, PUMP)
            await kit.call("configuration.reload")
            found = (await start)["outcomes"]
            ended = "plant.another_meanwhile" if rest else "plant.another_group_meanwhile"
            assert [outcome.get("code") for outcome in found.values()] == [None, ended, ended]
            assert station.motor.starts == 0

    run(scenario())


def test_a_drive_with_an_unfinished_stop_is_not_removed_from_its_bus(tmp_path: Path) -> None:
    """The service did not start it and its state is unknown, so only the unfinished stop keeps it."""
    file = write(tmp_path / "plant.toml", FAN_1, FAN_2, PUMP)

    async def scenario() -> None:
        async with running_service(load(file)) as kit:
            await asyncio.sleep(3)
            drive = kit.service.plant.drives["fan-2"]
            simulated_bus_of(drive.bus.port).unplug()
            await asyncio.sleep(5)
            stop = asyncio.create_task(kit.call("drive.stop", drive="fan-2"))
            await asyncio.sleep(0.1)
            assert drive.drive.stopping and not drive.drive.stop_pending
            write(file, FAN_1, PUMP)
            with pytest.raises(ServiceError) as rejected:
                await kit.call("configuration.reload")
            assert rejected.value.key == "plant.reload_turning"
            with pytest.raises(StopUnconfirmed):
                await stop
            assert drive.drive.stopping

    run(scenario())


def test_a_reload_clears_the_alarms_of_what_it_removes(tmp_path: Path) -> None:
    """Of an interlock, a drive and a bus: the supervision cycle no longer visits them, so nothing else clears these."""
    interlock = '[interlock.air]\ndrives = ["fan-1"]\nrequire = "fan-2.state == running"\n'
    file = write(tmp_path / "plant.toml", FAN_1, FAN_2, PUMP, interlock)

    async def scenario() -> None:
        async with running_service(load(file)) as kit:
            await asyncio.sleep(2.1)  # between two cycles, which would clear alarms without a cause
            raise_alarm = kit.service.plant.raise_alarm
            raise_alarm(SystemAlarm.INTERLOCK_TRIP, "fan-1", subject="air")
            raise_alarm(SystemAlarm.RUNNING_AT_START, "fan-2")
            raise_alarm(SystemAlarm.RUNNING_AT_START, "fan-1")
            raise_alarm(SystemAlarm.FOREIGN_MASTER, subject="b")
            raise_alarm(SystemAlarm.FOREIGN_MASTER, subject="a")
            raise_alarm(SystemAlarm.STORAGE_FAILURE, subject="incidents")
            head = HEAD.partition("[bus.b]")[0]
            write(file, FAN_1, head=head)
            await kit.call("configuration.reload")
            assert uncleared_alarms(kit) == {
                ("running_at_start", "fan-1", ""),
                ("foreign_master", "", "a"),
                ("storage_failure", "", "incidents"),
            }
            await asyncio.sleep(10)
            left = {alarm for alarm in uncleared_alarms(kit) if alarm[0] != "running_at_start"}
            assert left == set(), "no cycle raises an alarm of something removed"

    run(scenario())


def test_a_file_that_others_can_write_is_not_taken_over(tmp_path: Path) -> None:
    """Else they could lift the limits of a drive while the service runs."""
    file = write(tmp_path / "plant.toml", FAN_1)

    async def scenario() -> None:
        async with running_service(load(file)) as kit:
            write(file, FAN_1, "[drive.fan-1.limits]\nmaximum_hz = 40.0\n")
            file.chmod(0o666)
            with pytest.raises(ConfigurationError, match="chmod go-w"):
                await kit.call("configuration.reload")
            assert kit.service.plant.config.drives[0].limits.maximum_hz is None
            file.chmod(0o644)
            await kit.call("configuration.reload")
            assert kit.service.plant.config.drives[0].limits.maximum_hz == 40.0

    run(scenario())


@contextmanager
def failing_status(drive: DriveRuntime) -> Iterator[None]:
    """Let the status of a drive fail, as by a dialect that can't decode what it reports; it is logged each time."""

    def fail() -> None:
        raise ZeroDivisionError

    with pytest.MonkeyPatch.context() as context:
        context.setattr(logging.getLogger("drivebus.service"), "exception", lambda *_: None)
        context.setattr(drive, "status", fail)
        yield


@pytest.mark.parametrize("replaced", [False, True])
def test_a_drive_whose_status_cannot_be_made_does_not_leave_its_bus_and_the_refusal_names_it(
    tmp_path: Path, replaced: bool
) -> None:
    """It stood still when its state was known last, and may have been started at its keypad since."""
    file = write(tmp_path / "plant.toml", FAN_1, FAN_2, PUMP)

    async def scenario() -> None:
        async with running_service(load(file)) as kit:
            await asyncio.sleep(5)
            drive = kit.service.plant.drives["fan-2"]
            write(file, FAN_1, FAN_2.replace("address = 2", "address = 3") if replaced else "", PUMP)
            with failing_status(drive), pytest.raises(ServiceError, match=r"fan-2.*restart the service") as refused:
                await kit.call("configuration.reload")
            assert refused.value.key == "plant.reload_no_status"
            assert kit.service.plant.drives["fan-2"] is drive
            await kit.call("configuration.reload")
            assert kit.service.plant.drives.get("fan-2") is not drive

    run(scenario())


def test_new_limits_of_a_drive_whose_status_cannot_be_made_apply_with_all_other_changes(
    tmp_path: Path,
) -> None:
    """The reload had failed after its changes were made, without an answer that says so."""
    file = write(tmp_path / "plant.toml", FAN_1, FAN_2, PUMP)

    async def scenario() -> None:
        async with running_service(load(file)) as kit:
            await asyncio.sleep(5)
            drive = kit.service.plant.drives["fan-2"]
            write(file, FAN_1, FAN_2, "[drive.fan-2.limits]\nmaximum_hz = 30.0\n")
            with failing_status(drive):
                found = await kit.call("configuration.reload")
            assert found["difference"] == {"added": [], "changed": ["fan-2"], "removed": ["pump-1"]}
            assert drive.drive.range_hz[1] == 30.0

    run(scenario())
