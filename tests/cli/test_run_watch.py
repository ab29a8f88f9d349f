"""Remarks about an attached drive that does not do what was commanded: each once."""

from __future__ import annotations

from dataclasses import replace

import pytest

from drivebus.cli.run_watch import RunWatch
from drivebus.drives.state import Direction, DriveState, DriveStatus
from drivebus.errors import DrivebusError, NoReply, PortLost
from drivebus.values import Quality, Reading

FORWARD, REVERSE = Direction.FORWARD, Direction.REVERSE
STARTED_AT = 99.4


def status(
    hz: float,
    direction: Direction | None = FORWARD,
    state: DriveState = DriveState.RUNNING,
    quality: Quality = Quality.GOOD,
) -> DriveStatus:
    frequency = Reading(value=hz, unit="Hz", quality=quality)
    return DriveStatus(state=state, direction=direction, readings={"output_frequency": frequency})


def remarks(watch: RunWatch, *shown: DriveStatus, period_s: float = 0.5) -> list[str]:
    found = []
    for turn, status in enumerate(shown):
        now = 100.0 + turn * period_s
        readings = {name: replace(reading, source_time=now) for name, reading in status.readings.items()}
        found += watch.update(replace(status, readings=readings), now)
    return [remark.key for remark in found]


def test_a_change_of_direction_is_remarked_on_once_and_again_after_it_was_gone() -> None:
    watch = RunWatch(10.0, FORWARD, STARTED_AT)
    assert remarks(watch, status(10.0), *[status(10.0, REVERSE)] * 3) == ["run.wrong_direction"]
    assert remarks(watch, status(10.0), status(10.0, REVERSE)) == ["run.wrong_direction"]
    assert remarks(watch, status(10.0, None)) == []


@pytest.mark.parametrize(("hz", "key"), [(0.0, "run.zero_speed"), (5.0, "run.other_speed"), (20.0, "run.other_speed")])
def test_a_speed_that_stays_far_from_the_commanded_one_is_remarked_on_once(hz: float, key: str) -> None:
    assert remarks(RunWatch(10.0, FORWARD, STARTED_AT), *[status(hz)] * 11) == [key]
    assert remarks(RunWatch(10.0, FORWARD, STARTED_AT), *[status(hz)] * 10) == []
    assert remarks(RunWatch(10.0, FORWARD, STARTED_AT), *[status(hz)] * 40) == [key]


@pytest.mark.parametrize("commanded_hz", [0.5, 0.1])
def test_an_output_of_0_hz_is_remarked_on_at_a_low_frequency_too(commanded_hz: float) -> None:
    """A C320 is capped at 0.5 Hz until its step is known; one that stood still there was not remarked on."""
    assert remarks(RunWatch(commanded_hz, FORWARD, STARTED_AT), *[status(0.0)] * 11) == ["run.zero_speed"]
    assert remarks(RunWatch(commanded_hz, FORWARD, STARTED_AT), *[status(commanded_hz)] * 40) == []


def test_an_output_of_0_hz_is_no_other_speed_where_0_hz_or_less_than_a_step_was_commanded() -> None:
    for commanded_hz in (0.0, 0.05):
        assert remarks(RunWatch(commanded_hz, FORWARD, STARTED_AT), *[status(0.0)] * 40) == []


def test_a_drive_that_accelerates_slowly_or_reaches_its_speed_is_not_remarked_on() -> None:
    slow = [status(0.014 * turn, state=DriveState.ACCELERATING) for turn in range(600)]
    assert remarks(RunWatch(50.0, FORWARD, STARTED_AT), *slow) == []
    assert remarks(RunWatch(10.0, FORWARD, STARTED_AT), *[status(9.4)] * 40) == []


def test_a_speed_that_is_not_certain_or_a_drive_that_does_not_run_is_not_remarked_on() -> None:
    assert remarks(RunWatch(10.0, FORWARD, STARTED_AT), *[status(1.0, quality=Quality.UNCERTAIN)] * 40) == []
    assert remarks(RunWatch(10.0, FORWARD, STARTED_AT), *[status(0.0, None, DriveState.STOPPED)] * 40) == []


LOST = PortLost("ports.lost", port="/dev/ttyUSB0", reason="unplugged")
SILENT = NoReply("bus.no_reply", station=1, milliseconds=120, attempt=2)
OFFLINE = NoReply("bus.offline", station=1)


def outage(watch: RunWatch, *errors: DrivebusError, period_s: float = 0.5) -> list[tuple[float, str]]:
    """Return time and key of each remark about failed statuses, the first of them at 0 s."""
    found = [(turn * period_s, watch.on_failure(error, 100.0 + turn * period_s)) for turn, error in enumerate(errors)]
    return [(at_s, remark.key) for at_s, remark in found if remark is not None]


def test_a_lost_port_is_remarked_on_at_once_and_every_ten_seconds() -> None:
    assert outage(RunWatch(10.0, FORWARD, STARTED_AT), *[LOST] * 50) == [
        (0.0, "run.port_lost"),
        (10.0, "run.port_lost"),
        (20.0, "run.port_lost"),
    ]


def test_a_new_reason_is_remarked_on_at_once_and_reasons_that_alternate_are_not() -> None:
    errors = [SILENT, OFFLINE, SILENT, OFFLINE, SILENT, OFFLINE, LOST, LOST]
    assert outage(RunWatch(10.0, FORWARD, STARTED_AT), *errors) == [
        (0.0, "run.no_reply"),
        (0.5, "run.no_reply"),
        (3.0, "run.port_lost"),
    ]


def test_the_remarks_about_an_unknown_state_count_from_the_last_known_one_and_end_with_a_sentence() -> None:
    watch = RunWatch(10.0, FORWARD, STARTED_AT)
    assert watch.update(status(10.0), 100.0) == []
    remark = watch.on_failure(SILENT, 101.5)
    assert remark is not None and remark.params["seconds"] == 1.5
    assert "no reply" in remark.params["why"].en and remark.params["why"].zh != remark.params["why"].en
    (back,) = watch.update(status(10.0), 104.0)
    assert (back.key, back.params) == ("run.known_again", {"seconds": 4.0})
    assert watch.update(status(10.0), 104.5) == []
    assert outage(watch, SILENT) == [(0.0, "run.no_reply")]


def test_an_outage_from_the_first_status_on_counts_from_the_start() -> None:
    """A duration of 0.0 s would say that a reply has just come."""
    remark = RunWatch(10.0, FORWARD, STARTED_AT).on_failure(SILENT, 100.0)
    assert remark is not None and remark.params["seconds"] == 0.6


def test_a_status_without_a_state_is_an_outage_except_of_a_drive_that_reports_none() -> None:
    """The service of a remote drive gives a status although its port is lost."""
    for reason, expected in (("drives.port_lost", ["run.no_reply"]), ("drives.no_run_status", [])):
        shown = DriveStatus(state=DriveState.UNKNOWN, reason=reason)
        assert remarks(RunWatch(10.0, FORWARD, STARTED_AT), *[shown] * 10) == expected
