"""A reload of plant.toml while something else is under way: a start, a change of limits, the end of the service."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drivebus.errors import ServiceUnavailable, Superseded
from drivebus.service.config.load import load
from drivebus.testing.virtual_time import run
from fixtures.service import WIDEST_LIMITS, ServiceKit, running_service

HEAD = """
format = 1
[plant]
id = "hall"
[bus.a]
port = "sim://c320@1-3?ramp=2&name=a"
"""
OTHER_PORT = HEAD.replace("name=a", "name=other")
FAN_1 = '[drive.fan-1]\nbus = "a"\naddress = 1\nmodel = "c320"\n'
FAN_2 = '[drive.fan-2]\nbus = "a"\naddress = 2\nmodel = "c320"\n'
MOVED_FAN_1 = FAN_1.replace("address = 1", "address = 3")
GROUP = """
[group.fans]
drives = ["fan-1", "fan-2"]
leader = "fan-1"
start_interval_s = 4.0
ratios = { fan-2 = 2.0 }
"""


def write(file: Path, *parts: str, head: str = HEAD) -> Path:
    file.write_text(head + "".join(parts))
    return file


async def ready(kit: ServiceKit) -> None:
    await asyncio.sleep(5)
    await kit.grant_waivers()


@pytest.mark.parametrize(
    ("parts", "inhibited"),
    [
        ((FAN_1.replace("fan-1", "mill"), FAN_2), ["mill"]),
        (
            (FAN_1.replace("address = 1", "address = 2"), FAN_2.replace("address = 2", "address = 1")),
            ["fan-1", "fan-2"],
        ),
    ],
    ids=["renamed", "swapped"],
)
def test_a_motor_that_a_bus_stop_holds_is_not_released_by_another_name_on_another_port(
    tmp_path: Path, parts: tuple[str, ...], inhibited: list[str]
) -> None:
    """The inhibit followed the name only: the motor of before could be started under its new name."""
    file = write(tmp_path / "plant.toml", FAN_1, FAN_2)

    async def scenario() -> None:
        async with running_service(load(file)) as kit:
            await ready(kit)
            await kit.call("plant.stop")
            await kit.call("start_inhibit.release", drive="fan-2")
            write(file, *parts, head=OTHER_PORT)
            await kit.call("configuration.reload")
            views = (await kit.call("drives.list"))["drives"]
            assert sorted(view["id"] for view in views if view["start_inhibited"]) == inhibited

    run(scenario())


@pytest.mark.parametrize("group", ["", GROUP.replace("2.0", "1.0"), GROUP.replace("4.0", "9.0")])
def test_a_group_start_ends_where_a_reload_changes_the_group(tmp_path: Path, group: str) -> None:
    """A follower started at its former ratio, which the file no longer has."""
    file = write(tmp_path / "plant.toml", FAN_1, FAN_2, GROUP)

    async def scenario() -> None:
        async with running_service(load(file)) as kit:
            await ready(kit)
            start = asyncio.create_task(kit.call("group.start", group="fans", frequency_hz=20.0))
            await asyncio.sleep(2.5)
            write(file, FAN_1, FAN_2, group)
            await kit.call("configuration.reload")
            outcomes = (await start)["outcomes"]
            assert outcomes["fan-1"]["status"] == "confirmed"
            assert outcomes["fan-2"]["code"] == "plant.another_group_meanwhile"
            assert kit.station("fan-2").motor.starts == 0

    run(scenario())


def test_a_follower_gets_no_frequency_at_a_ratio_that_a_reload_has_changed(tmp_path: Path) -> None:
    """The leader has its new frequency by then."""
    file = write(tmp_path / "plant.toml", FAN_1, FAN_2, GROUP)

    async def scenario() -> None:
        async with running_service(load(file)) as kit:
            await ready(kit)
            await kit.call("group.start", group="fans", frequency_hz=10.0)
            write(file, FAN_1, FAN_2, GROUP.replace("2.0", "1.0"))
            change = asyncio.create_task(kit.call("group.set_frequency", group="fans", frequency_hz=20.0))
            await asyncio.sleep(0.01)
            await kit.call("configuration.reload")
            outcomes = (await change)["outcomes"]
            assert outcomes["fan-1"]["status"] == "acknowledged"
            assert outcomes["fan-2"]["code"] == "plant.another_group_meanwhile"
            assert kit.station("fan-2").motor.target_hz == 20.0

    run(scenario())


def reload_before_storing(kit: ServiceKit, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a reload read the settings after a change of one was requested and before it is stored."""

    async def to_thread(work: Callable[..., Any], *params: Any) -> Any:
        await kit.call("configuration.reload")
        return work(*params)

    monkeypatch.setattr("drivebus.service.control.drive_commands.asyncio.to_thread", to_thread)


def test_a_forbidden_direction_holds_for_a_motor_that_a_reload_brought_meanwhile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The answer gave the new maximum, and the drive had the limits of before until the next restart."""
    file = write(tmp_path / "plant.toml", FAN_1, FAN_2)

    async def scenario() -> None:
        async with running_service(load(file)) as kit:
            await ready(kit)
            write(file, MOVED_FAN_1, FAN_2)
            with monkeypatch.context() as patched:
                reload_before_storing(kit, patched)
                limits = WIDEST_LIMITS | {"maximum_hz": 20.0, "reverse": False}
                await kit.call("drive.limits", drive="fan-1", **limits)
            view = await kit.call("drives.get", drive="fan-1")
            assert (view["address"], view["maximum_hz"], view["directions"]) == (3, 20.0, ["forward"])

    run(scenario())


@pytest.mark.parametrize("operation", ["waiver.revoke", "waiver.grant"])
def test_a_waiver_that_a_reload_overtakes_permits_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, operation: str
) -> None:
    """A revoked one was in force again until the next restart; one that is recorded is for the motor of before."""
    file = write(tmp_path / "plant.toml", FAN_1, FAN_2)

    async def scenario() -> None:
        async with running_service(load(file)) as kit:
            await asyncio.sleep(5)
            if operation == "waiver.revoke":
                await kit.grant_waivers("fan-1")
            write(file, FAN_1 + 'options = { setpoint_step = "0.01" }\n', FAN_2)
            with monkeypatch.context() as patched:
                reload_before_storing(kit, patched)
                if operation == "waiver.revoke":
                    await kit.call(operation, drive="fan-1")
                else:
                    with pytest.raises(Superseded):
                        await kit.call(operation, drive="fan-1", reason="test bench")
            kit.service.plant.restore(kit.service.plant.drives["fan-1"])  # as a restart does
            view = await kit.call("drives.get", drive="fan-1")
            assert view["comm_loss"]["waiver"] is None
            assert "plant.waiver_needed" in [blocker["key"] for blocker in view["start_blockers"]]

    run(scenario())


def test_a_reload_that_the_end_of_the_service_overtakes_opens_no_bus(tmp_path: Path) -> None:
    """It opened the port of a new bus after the service had ended."""
    file = write(tmp_path / "plant.toml", FAN_1, FAN_2)

    async def scenario() -> None:
        async with running_service(load(file)) as kit:
            await ready(kit)
            await kit.call("drive.run", drive="fan-1", frequency_hz=20.0)
            write(file, FAN_1, FAN_2, '[bus.b]\nport = "sim://vc660@1"\n')
            kit.trail.delay_s = 0.5
            reload = asyncio.create_task(kit.call("configuration.reload"))
            await asyncio.sleep(0.1)
            kit.trail.delay_s = 0.0
            await kit.service.stop()
            with pytest.raises(ServiceUnavailable):
                await reload
            assert list(kit.service.plant.buses) == ["a"]

    run(scenario())
