"""Starts: what refuses them, their arm tokens and audit records, and whether a drive counts as started."""

from __future__ import annotations

import asyncio
from contextlib import nullcontext
from dataclasses import replace

import pytest

from drivebus.drives.drive import Drive
from drivebus.drives.outcome import Outcome
from drivebus.drives.state import DriveState
from drivebus.errors import (
    ArmRequired,
    AuditUnavailable,
    DrivebusError,
    LimitError,
    NoReply,
    StartInhibited,
)
from drivebus.service.runtime.drive_reports import STANDSTILL_CONFIRM_S, report_motion
from drivebus.testing.virtual_time import run
from fixtures.service import blocked, ready, remote_actor, running_service


def test_a_view_lists_a_bad_link_as_start_blocker() -> None:
    """A link is bad with three damaged replies in five minutes that are more than 1 % of all."""

    async def scenario() -> None:
        async with running_service() as kit:
            await ready(kit)
            assert not await blocked(kit, "fan-1")
            bench = kit.simulated_bus("fan-1")
            for quality in ("flip=0.02", "clean"):
                bench.line_quality = quality
                await asyncio.sleep(20)
            assert [blocker["key"] for blocker in await blocked(kit, "fan-1")] == ["drives.high_error_rate"]
            with pytest.raises(StartInhibited):
                await kit.call("drive.run", drive="fan-1", frequency_hz=20.0)
            assert kit.station("fan-1").motor.starts == 0

    run(scenario())


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
