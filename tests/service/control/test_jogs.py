"""Jogs of a user of the service: renewed, ended, and only under their own drive."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest

from drivebus.drives.dialects.sunfar import SunfarDialect
from drivebus.drives.state import Direction, DriveState
from drivebus.errors import ArmRequired, NotFound
from drivebus.service.api.errors import localized
from drivebus.service.runtime.drive import DriveRuntime
from drivebus.simulator.motor import OutputPhase
from drivebus.testing.virtual_time import run
from fixtures.service import LOCAL, ready, remote_actor, running_service


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


@pytest.mark.parametrize("direction", [*Direction])
@pytest.mark.parametrize("is_exchanged", [False, True])
def test_the_renewals_of_a_jog_remark_on_a_drive_that_reports_the_other_direction(
    monkeypatch: pytest.MonkeyPatch, direction: Direction, is_exchanged: bool
) -> None:
    """The drive gets the jog of the other direction, as one whose direction bits are exchanged."""
    other = Direction.REVERSE if direction is Direction.FORWARD else Direction.FORWARD
    jog_frames = SunfarDialect.jog
    sent = other if is_exchanged else direction
    monkeypatch.setattr(SunfarDialect, "jog", lambda self, _, word: jog_frames(self, sent, word))

    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit)
            jog = (await kit.call("drive.jog", drive="fan-1", frequency_hz=5.0, direction=direction.value))["jog"]
            remarks = []
            for _ in range(10):
                await asyncio.sleep(0.15)
                remarks.append((await kit.call("drive.jog_renew", drive="fan-1", jog=jog))["remark"])
            wrong = localized("drives.wrong_direction", {"expected": direction, "found": other})
            assert remarks[-1] == (wrong if is_exchanged else None)
            assert is_exchanged or not any(remarks)

    run(scenario())


@pytest.mark.parametrize(("state", "is_remarked_on"), [(DriveState.RUNNING, True), (DriveState.STOPPED, False)])
def test_a_drive_at_standstill_that_reports_the_other_direction_has_no_remark(
    monkeypatch: pytest.MonkeyPatch, state: DriveState, is_remarked_on: bool
) -> None:
    """The direction that it reports is that of its last run."""

    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit)
            jog = (await kit.call("drive.jog", drive="fan-1", frequency_hz=5.0))["jog"]
            status = kit.service.plant.drives["fan-1"].status()
            reported = replace(status, state=state, direction=Direction.REVERSE)
            with monkeypatch.context() as patch:
                patch.setattr(DriveRuntime, "status", lambda _: reported)
                renewed = await kit.call("drive.jog_renew", drive="fan-1", jog=jog)
            assert (renewed["remark"] is not None) is is_remarked_on

    run(scenario())
