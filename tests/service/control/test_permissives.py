"""Everything that forbids a start is said before anybody tries, and refuses whoever does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from drivebus.errors import DrivebusError
from drivebus.service.config.model import InterlockConfig
from drivebus.service.control.permissives import check_start, start_blockers_json
from drivebus.service.control.waivers import CommLossWaiver
from drivebus.service.live.views import CommLossView
from drivebus.testing.virtual_time import run
from drivebus.values import Text
from fixtures.service import ServiceKit, running_service


def stopping(kit: ServiceKit) -> None:
    kit.service.plant.state = "stopping"


def latched(kit: ServiceKit) -> None:
    unit = kit.service.plant.drives["fan-1"]
    unit.bus.start_inhibited = lambda address: address == unit.config.address  # type: ignore[method-assign]


def doubted(**health: Any) -> Callable[[ServiceKit], None]:
    def doubt(kit: ServiceKit) -> None:
        bus = kit.service.plant.drives["fan-1"].bus
        plain = bus.health
        bus.health = lambda address: replace(plain(address), **health)  # type: ignore[method-assign]

    return doubt


def unwaived(kit: ServiceKit) -> None:
    kit.service.plant.drives["fan-1"].waiver = None


def deaf(kit: ServiceKit) -> None:
    kit.trail.broken = True


def interlocked(kit: ServiceKit) -> None:
    kit.service.plant.interlocks.replace([InterlockConfig("i", ("fan-1",), "pump-1.output_frequency > 5 Hz")])


HINDRANCES = {
    "plant.stopping": stopping,
    "drives.latched": latched,
    "drives.foreign_master": doubted(foreign_master=True),
    "drives.duplicate": doubted(duplicate_address=True),
    "drives.high_error_rate": doubted(damage_rate=0.5, damaged=100),
    "interlocks.violated": interlocked,
    "plant.waiver_needed": unwaived,
    "plant.audit_unavailable": deaf,
}


def found(kit: ServiceKit) -> list[str]:
    """What is said of a start; the first of it refuses one."""
    unit = kit.service.plant.drives["fan-1"]
    text = list(start_blockers_json(kit.service.plant, unit))
    if not text:
        check_start(kit.service.plant, unit)
        return []
    with pytest.raises(DrivebusError) as refused:
        check_start(kit.service.plant, unit)
    assert refused.value.key == text[0]["key"]
    assert all(one.keys() == {"key", "params", "text"} and one["text"].keys() == {"en", "zh"} for one in text)
    return [one["key"] for one in text]


@pytest.mark.parametrize("key", HINDRANCES)
def test_each_thing_that_forbids_a_start_does_so_by_itself(key: str) -> None:
    async def story() -> None:
        async with running_service() as kit:
            kit.service.plant.drives["fan-1"].waiver = "tested (ann)"
            assert found(kit) == []
            HINDRANCES[key](kit)
            assert found(kit) == [key]
            kit.service.plant.state = "running"

    run(story())


def test_all_that_forbids_a_start_is_said_at_once_and_an_ending_plant_says_only_that() -> None:
    async def story() -> None:
        async with running_service() as kit:
            for key, hinder in HINDRANCES.items():
                if key != "plant.stopping":
                    hinder(kit)
            assert found(kit) == [key for key in HINDRANCES if key != "plant.stopping"]
            stopping(kit)
            assert found(kit) == ["plant.stopping"]
            kit.service.plant.state = "running"

    run(story())


@pytest.mark.parametrize(("kind", "may"), [("trips", True), ("runs_on", False), ("unknown", False)])
def test_only_a_drive_that_trips_starts_without_a_waiver(kind: str, may: bool) -> None:
    async def story() -> None:
        async with running_service() as kit:
            unit = kit.service.plant.drives["fan-1"]
            unit.comm_loss_read, unit.comm_loss_stale = CommLossView(kind, 1.0, Text("why", "原因")), False
            assert found(kit) == ([] if may else ["plant.waiver_needed"])

    run(story())


def test_a_waiver_of_another_drive_is_named() -> None:
    async def story() -> None:
        async with running_service() as kit:
            kit.service.plant.drives["fan-1"].waiver_of_another = CommLossWaiver(
                "tested (ann)", "c300", "sim://c300@1", 7
            )
            assert found(kit) == ["plant.waiver_of_another"]

    run(story())
