"""Conclusions from the reports of a drive: who started it, whether it may be running, and who stopped it."""

from __future__ import annotations

import asyncio
import logging
from dataclasses import replace

import pytest

from drivebus.drives.outcome import Outcome
from drivebus.drives.state import DriveState
from drivebus.errors import NoReply
from drivebus.service.runtime.drive_reports import STANDSTILL_CONFIRM_S, report_motion
from drivebus.testing.virtual_time import run
from fixtures.service import running_service


@pytest.mark.parametrize("by_service", [True, False])
def test_a_drive_first_read_as_turning_after_its_start_is_an_event_only_where_the_service_has_not_started_it(
    by_service: bool,
) -> None:
    """A start without reply ends before the drive is read as turning."""

    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(2)
            drive = kit.service.plant.drives["fan-1"]
            drive.started_by_service = by_service
            report_motion(kit.service.plant, drive, replace(drive.status(), state=DriveState.RUNNING))
            assert kit.drives_of_events("plant.started_by_itself") == ["fan-1"] * (not by_service)

    run(scenario())


@pytest.mark.parametrize("turned", [True, False])
def test_a_drive_whose_status_fails_may_be_running_where_it_turned_when_its_state_was_known_last(
    monkeypatch: pytest.MonkeyPatch, turned: bool
) -> None:
    def fail() -> None:
        raise ValueError("broken")

    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(2)
            drive = kit.service.plant.drives["fan-1"]
            monkeypatch.setattr(logging.getLogger("drivebus.service"), "exception", lambda *_: None)
            monkeypatch.setattr(drive, "status", fail)
            drive.last_known_turning = turned
            assert drive.may_be_running is turned

    run(scenario())


def test_a_start_without_reply_hides_no_stop_that_was_requested_during_it() -> None:
    """The view of the drive names who stopped it, until it is started again."""

    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(2)
            plant, drive = kit.service.plant, kit.service.plant.drives["fan-1"]

            async def start() -> Outcome:
                plant.record_stop_request(drive, by="bob", kind="drive")
                error = NoReply("bus.no_reply", station=1)
                error.may_be_running = True
                raise error

            with pytest.raises(NoReply):
                await kit.service.commands.run_motion(drive, start())
            assert drive.last_stop is not None and drive.last_stop.actor == "bob"

    run(scenario())


@pytest.mark.parametrize("adopted", [True, False])
def test_a_standstill_ends_the_frequency_of_an_adopted_run_and_not_one_that_was_set_at_rest(adopted: bool) -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(2)
            drive = kit.service.plant.drives["fan-1"]
            drive.adopted, drive.commanded_hz = adopted, 20.0
            at = drive.last_motion_at + STANDSTILL_CONFIRM_S + 0.1
            report_motion(kit.service.plant, drive, replace(drive.status(), state=DriveState.STOPPED, at=at))
            assert drive.commanded_hz == (None if adopted else 20.0)

    run(scenario())
