"""Remarks about an attached drive that does not do what was commanded: each once."""

from __future__ import annotations

import pytest

from drivebus.cli.run_watch import RunWatch
from drivebus.drives.state import Direction, DriveState, DriveStatus
from drivebus.values import Quality, Reading

FORWARD, REVERSE = Direction.FORWARD, Direction.REVERSE


def status(
    hz: float,
    direction: Direction | None = FORWARD,
    state: DriveState = DriveState.RUNNING,
    quality: Quality = Quality.GOOD,
) -> DriveStatus:
    frequency = Reading(value=hz, unit="Hz", quality=quality, source_time=0.0)
    return DriveStatus(state=state, direction=direction, readings={"output_frequency": frequency})


def remarks(watch: RunWatch, *shown: DriveStatus, period_s: float = 0.5) -> list[str]:
    return [remark.key for turn, one in enumerate(shown) for remark in watch.update(one, 100.0 + turn * period_s)]


def test_a_change_of_direction_is_remarked_on_once_and_again_after_it_was_gone() -> None:
    watch = RunWatch(10.0, FORWARD)
    assert remarks(watch, status(10.0), *[status(10.0, REVERSE)] * 3) == ["run.wrong_direction"]
    assert remarks(watch, status(10.0), status(10.0, REVERSE)) == ["run.wrong_direction"]
    assert remarks(watch, status(10.0, None)) == []


@pytest.mark.parametrize(("hz", "key"), [(0.0, "run.zero_speed"), (5.0, "run.other_speed"), (20.0, "run.other_speed")])
def test_a_speed_that_stays_far_from_the_commanded_one_is_remarked_on_once(hz: float, key: str) -> None:
    assert remarks(RunWatch(10.0, FORWARD), *[status(hz)] * 11) == [key]
    assert remarks(RunWatch(10.0, FORWARD), *[status(hz)] * 10) == []
    assert remarks(RunWatch(10.0, FORWARD), *[status(hz)] * 40) == [key]


def test_a_drive_that_accelerates_slowly_or_reaches_its_speed_is_not_remarked_on() -> None:
    slow = [status(0.014 * turn, state=DriveState.ACCELERATING) for turn in range(600)]
    assert remarks(RunWatch(50.0, FORWARD), *slow) == []
    assert remarks(RunWatch(10.0, FORWARD), *[status(9.4)] * 40) == []


def test_a_speed_that_is_not_certain_or_a_drive_that_does_not_run_is_not_remarked_on() -> None:
    assert remarks(RunWatch(10.0, FORWARD), *[status(1.0, quality=Quality.UNCERTAIN)] * 40) == []
    assert remarks(RunWatch(10.0, FORWARD), *[status(0.0, None, DriveState.STOPPED)] * 40) == []
