"""One clock from the wish to the first bit: record, turn and checks of a start share five seconds (I1)."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from drivebus.drives.operations import context
from drivebus.drives.outcome import Outcome
from drivebus.drives.permissives import COMMAND_TTL_S, CommandKind
from drivebus.errors import Expired
from drivebus.service.config.model import GroupConfig
from drivebus.service.control.tickets import START_DEADLINE_S
from drivebus.testing.virtual_time import run
from fixtures.service import ServiceKit, plant_config, running_service

GROUP = GroupConfig("fans", ("fan-1", "fan-2"), start_interval_s=4.0)
MOTIONS: dict[str, tuple[str, dict[str, Any]]] = {
    "run": ("drive.run", {"drive": "fan-1", "frequency_hz": 20.0}),
    "jog": ("drive.jog", {"drive": "fan-1", "frequency_hz": 5.0}),
    "group": ("group.start", {"group": "fans", "frequency_hz": 20.0}),
}


async def begun_after_s(kit: ServiceKit, name: str, record_s: float) -> float | None:
    """How long after it was wished the motor began; None where it did not."""
    context, params = MOTIONS[name]
    kit.trail.delay_s = record_s
    wished_at, motor = kit.service.plant.now(), kit.station("fan-1").motor
    start = asyncio.create_task(kit.call(context, **params))
    while not start.done():
        await asyncio.sleep(0.005)
        if motor.phase.value != "off":
            age_s = kit.service.plant.now() - wished_at
            await start
            return age_s
    with pytest.raises(Expired):
        await start
    return None


@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize(("record_s", "limit_s", "begins"), [(1.0, 2.0, True), (1.7, 2.0, False), (1.99, 2.5, False)])
def test_i1_a_slow_record_leaves_the_checks_less_time(
    name: str, record_s: float, limit_s: float, begins: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The checks of this line take 0.7 s; neither they nor the record are too slow by themselves."""
    monkeypatch.setattr(context, "CHECKS_TIMEOUT_S", limit_s)

    async def story() -> None:
        async with running_service(plant_config(groups=(GROUP,))) as kit:
            await asyncio.sleep(2)
            await kit.grant_waivers()
            age_s = await begun_after_s(kit, name, record_s)
            assert (age_s is not None) is begins
            if age_s is not None:
                assert record_s < age_s <= limit_s
            assert kit.station("fan-2").motor.starts == (1 if begins and name == "group" else 0)

    run(story())


@pytest.mark.parametrize("start_interval_s", [0.0, 3.0])
def test_each_further_drive_of_a_group_has_a_clock_of_its_own(
    start_interval_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its turn comes seconds after the wish; the lease shows that somebody still wishes it."""
    monkeypatch.setattr(context, "CHECKS_TIMEOUT_S", COMMAND_TTL_S[CommandKind.START])

    async def story() -> None:
        group = GroupConfig(
            "fans", ("fan-1", "fan-2", "pump-1"), start_interval_s=start_interval_s, max_concurrent_starts=3
        )
        async with running_service(plant_config(groups=(group,))) as kit:
            await asyncio.sleep(2)
            await kit.grant_waivers()
            begun = kit.service.plant.now()
            found = await kit.call("group.start", group="fans", frequency_hz=20.0)
            assert [one.get("status") for one in found["outcomes"].values()] == ["confirmed"] * 3
            assert kit.service.plant.now() - begun > context.CHECKS_TIMEOUT_S

    run(story())


def test_a_frequency_is_as_old_as_its_wish_too() -> None:
    """Five seconds, or two where the frame moves."""

    async def story() -> None:
        async with running_service() as kit:
            await asyncio.sleep(2)
            kit.trail.delay_s = 1.5
            drive, asked, ages = kit.service.plant.drives["fan-1"].drive, kit.service.plant.now(), []
            plain = drive.set_frequency

            async def noted(frequency_hz: float, wished_at: float | None = None) -> Outcome:
                ages.append(wished_at)
                return await plain(frequency_hz, wished_at)

            drive.set_frequency = noted  # type: ignore[method-assign]
            await kit.call("drive.set_frequency", drive="fan-1", frequency_hz=20.0)
            assert ages == [asked]

    run(story())


def test_a_group_that_has_to_wait_for_its_first_turn_begins_when_that_comes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(context, "CHECKS_TIMEOUT_S", COMMAND_TTL_S[CommandKind.START])

    async def story() -> None:
        async with running_service(plant_config(groups=(GROUP,))) as kit:
            await asyncio.sleep(2)
            await kit.grant_waivers()
            await kit.call("group.start", group="fans", frequency_hz=20.0)
            stop = asyncio.create_task(kit.call("drive.stop", drive="fan-1"))
            await kit.call("lease.renew", drive="fan-1")
            await stop
            begun = kit.service.plant.now()
            found = await kit.call("group.start", group="fans", frequency_hz=20.0)
            assert found["outcomes"]["fan-1"]["status"] == "confirmed"
            assert kit.service.plant.now() - begun > context.CHECKS_TIMEOUT_S

    run(story())


def test_the_limits_are_those_of_ruling_12() -> None:
    assert COMMAND_TTL_S[CommandKind.START] == COMMAND_TTL_S[CommandKind.JOG] == 2.0
    assert START_DEADLINE_S == context.CHECKS_TIMEOUT_S == COMMAND_TTL_S[CommandKind.SETPOINT] == 5.0
