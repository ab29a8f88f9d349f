"""Start blockers: every view lists them, and the first one rejects a start."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from drivebus.errors import DrivebusError
from drivebus.protocols import sunfar
from drivebus.service.config.model import InterlockConfig
from drivebus.service.control.comm_loss_record import CommLossRecord, CommLossResult
from drivebus.service.control.start_blockers import check_start, check_test_start, start_blockers, start_blockers_json
from drivebus.service.control.waivers import CommLossWaiver
from drivebus.service.live.views import CommLossView
from drivebus.testing.virtual_time import run
from drivebus.values import Text, bilingual_text
from fixtures.service import ServiceKit, running_service
from fixtures.simulator import ForeignMaster


def stopping(kit: ServiceKit) -> None:
    kit.service.plant.state = "stopping"


def start_inhibited(kit: ServiceKit) -> None:
    drive = kit.service.plant.drives["fan-1"]
    drive.bus.start_inhibited = lambda address: address == drive.config.address  # type: ignore[method-assign]


def unhealthy(**health: Any) -> Callable[[ServiceKit], None]:
    def change(kit: ServiceKit) -> None:
        bus = kit.service.plant.drives["fan-1"].bus
        plain = bus.health
        bus.health = lambda address: replace(plain(address), **health)  # type: ignore[method-assign]

    return change


def unwaived(kit: ServiceKit) -> None:
    kit.service.plant.drives["fan-1"].comm_loss.waiver = None


def without_limits(kit: ServiceKit) -> None:
    kit.service.plant.drives["fan-1"].limits_lost = True


def unwritable(kit: ServiceKit) -> None:
    kit.trail.broken = True


def interlocked(kit: ServiceKit) -> None:
    kit.service.plant.interlocks.replace(
        [InterlockConfig(id="i", drives=("fan-1",), require="pump-1.output_frequency > 5 Hz")]
    )


BLOCKERS = {
    "plant.stopping": stopping,
    "drives.start_inhibited": start_inhibited,
    "drives.foreign_master": unhealthy(foreign_master=True),
    "drives.duplicate": unhealthy(duplicate_address=True),
    "drives.high_error_rate": unhealthy(damage_rate=0.5, damaged=100),
    "interlocks.violated": interlocked,
    "plant.waiver_needed": unwaived,
    "plant.limits_lost": without_limits,
    "plant.audit_unavailable": unwritable,
}


def blocker_keys(kit: ServiceKit, id: str = "fan-1") -> list[str]:
    """Return the keys of the start blockers, after checking that the first one rejects a start."""
    drive = kit.service.plant.drives[id]
    blockers = list(start_blockers_json(kit.service.plant, drive))
    if not blockers:
        check_start(kit.service.plant, drive)
        return []
    with pytest.raises(DrivebusError) as rejected:
        check_start(kit.service.plant, drive)
    assert rejected.value.key == blockers[0]["key"]
    assert all(blocker.keys() == {"key", "params", "text"} for blocker in blockers)
    assert all(blocker["text"].keys() == {"en", "zh"} for blocker in blockers)
    return [blocker["key"] for blocker in blockers]


@pytest.mark.parametrize("key", BLOCKERS)
def test_each_start_blocker_alone_rejects_a_start(key: str) -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            kit.service.plant.drives["fan-1"].comm_loss.waiver = "tested (ann)"
            assert blocker_keys(kit) == []
            BLOCKERS[key](kit)
            assert blocker_keys(kit) == [key]
            kit.service.plant.state = "running"

    run(scenario())


def test_a_foreign_master_is_an_alarm_of_its_bus_while_starts_are_refused_there() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(5)
            await kit.grant_waivers()
            wire, master = kit.simulated_bus("fan-1"), ForeignMaster()
            frame = sunfar.SunfarCodec().encode_request(sunfar.ReadMonitor(9, 1))
            found = []
            for requests, pause_s in ((0, 1), (20, 1), (0, 90)):
                for _ in range(requests):
                    wire.attach(master)
                    wire.transmit(master, frame)
                    await asyncio.sleep(0.37)
                    wire.detach(master)
                await asyncio.sleep(pause_s)
                alarms = [alarm for alarm in kit.service.plant.alarms.active() if alarm.cleared_ms is None]
                refused = ["drives.foreign_master" in blocker_keys(kit, drive) for drive in ("fan-1", "pump-1")]
                found.append(([alarm.text for alarm in alarms if alarm.kind == "foreign_master"], refused))
            bus = bilingual_text("plant.bus", id="a")
            text = bilingual_text("alarms.text.foreign_master", bus=bus)
            assert found == [([], [False, False]), ([text], [True, False]), ([], [False, False])]

    run(scenario())


def test_all_start_blockers_are_listed_and_a_stopping_service_lists_only_itself() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            for key, block in BLOCKERS.items():
                if key != "plant.stopping":
                    block(kit)
            assert blocker_keys(kit) == [key for key in BLOCKERS if key != "plant.stopping"]
            stopping(kit)
            assert blocker_keys(kit) == ["plant.stopping"]
            kit.service.plant.state = "running"

    run(scenario())


@pytest.mark.parametrize(("kind", "may"), [("trips", True), ("runs_on", False), ("unknown", False)])
def test_only_a_drive_that_trips_starts_without_a_waiver(kind: str, may: bool) -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            drive = kit.service.plant.drives["fan-1"]
            drive.comm_loss.last_read, drive.comm_loss.is_stale = (
                CommLossView(kind=kind, after_s=1.0, text=Text("why", "原因")),
                False,
            )
            assert blocker_keys(kit) == ([] if may else ["plant.waiver_needed"])

    run(scenario())


def test_a_waiver_of_another_drive_is_named() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            kit.service.plant.drives["fan-1"].comm_loss.waiver_of_another = CommLossWaiver(
                "tested (ann)", "c300", "sim://c300@1", 7
            )
            assert blocker_keys(kit) == ["plant.waiver_of_another"]

    run(scenario())


@pytest.mark.parametrize(
    ("read", "key", "is_outdated"),
    [
        ({"F2.01": 1}, "plant.waiver_needed_tested", False),
        ({"F2.01": 2}, "plant.waiver_needed", True),
        (None, "plant.waiver_needed", False),
    ],
    ids=["as at the test", "changed since", "not known"],
)
def test_only_a_test_that_still_holds_makes_another_one_useless(
    read: dict[str, int] | None, key: str, is_outdated: bool
) -> None:
    """After its parameters were changed the drive can be tested again instead of being waived."""

    async def scenario() -> None:
        async with running_service() as kit:
            unwaived(kit)
            drive = kit.service.plant.drives["fan-1"]
            drive.comm_loss.last_read = CommLossView(kind="unknown", after_s=None, text=Text("why", "原因"))
            drive.comm_loss.read_at, drive.comm_loss.is_stale, drive.comm_loss.values = 0.0, read is None, read or {}
            drive.comm_loss.record = CommLossRecord(
                result=CommLossResult.RUNS_ON,
                silence_s=20.0,
                time_ms=0,
                user="ann",
                model="c320",
                port="sim://",
                address=1,
                parameters={"F2.01": 1},
                fault=None,
            )
            assert blocker_keys(kit) == [key]
            (error,) = start_blockers(kit.service.plant, drive)
            text, params = drive.comm_loss.view.text, drive.comm_loss.record.message_params
            outdated = bilingual_text("plant.comm_loss_test_outdated", **{"why": text} | params)
            assert error.params["why"] == (outdated if is_outdated else text)

    run(scenario())


@pytest.mark.parametrize("key", [key for key in BLOCKERS if key != "plant.waiver_needed"])
def test_a_communication_loss_test_is_rejected_by_every_start_blocker_but_a_missing_waiver(key: str) -> None:
    """The test replaces the waiver; it moves the motor, so everything else that forbids a start forbids it."""

    async def scenario() -> None:
        async with running_service() as kit:
            plant, drive = kit.service.plant, kit.service.plant.drives["fan-1"]
            unwaived(kit)
            check_test_start(plant, drive)
            BLOCKERS[key](kit)
            with pytest.raises(DrivebusError) as rejected:
                check_test_start(plant, drive)
            assert rejected.value.key == key
            plant.state = "running"

    run(scenario())
