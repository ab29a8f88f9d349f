"""Times, counts and sync probes that a station keeps, without a bus."""

from __future__ import annotations

from dataclasses import replace

import pytest

from drivebus.bus.station import ProbeBudget, Station
from drivebus.protocols import modbus
from fixtures.bus import SETTINGS, station_config


def make_station() -> Station:
    return Station(station_config(), SETTINGS)


def losses_after(pause_s: float, *, suspect_after_s: float | None = None) -> int:
    """Return the contact losses of a station that replied twice with a pause, and was suspected so long after."""
    station = make_station()
    station.record_reply_time(40.0)
    if suspect_after_s is not None:
        station.mark_suspect(40.0 + suspect_after_s)
    station.record_reply_time(40.0 + pause_s)
    return station.contact_losses


@pytest.mark.parametrize(("pause_s", "losses"), [(120.0, 0), (120.1, 1)])
def test_a_drive_that_was_sent_nothing_for_two_minutes_may_be_another_one(pause_s: float, losses: int) -> None:
    assert losses_after(pause_s) == losses
    assert losses_after(pause_s, suspect_after_s=-1.0) == losses, "it has answered since"
    assert losses_after(pause_s, suspect_after_s=0.0) == losses


@pytest.mark.parametrize(("pause_s", "losses"), [(10.0, 0), (10.1, 1)])
def test_a_drive_that_did_not_answer_for_ten_seconds_may_be_another_one(pause_s: float, losses: int) -> None:
    assert losses_after(pause_s, suspect_after_s=1.0) == losses


def test_each_loss_of_contact_counts_and_the_first_reply_is_none() -> None:
    station = make_station()
    for at in (1000.0, 1200.0, 1201.0, 1400.0):
        station.record_reply_time(at)
    assert station.contact_losses == 2


def test_two_second_replies_within_ten_minutes_show_two_drives_at_one_address() -> None:
    station = make_station()
    station.last_request_sent_at = 50.0
    station.record_duplicate_reply(1.0)
    assert not station.has_duplicate_address(2.0)
    station.record_duplicate_reply(2.0)
    station.record_duplicate_reply(3.0)
    assert station.duplicate_reply_times == [2.0, 3.0]
    assert station.has_duplicate_address(602.0) and not station.has_duplicate_address(602.1)
    assert station.next_allowed_at(603.0) == 50.0
    assert station.next_allowed_at(603.1) == 0.0


def test_the_pauses_between_probes_begin_with_a_second_again_once_one_was_answered() -> None:
    station = make_station()
    pauses = []
    for _ in range(8):
        station.mark_offline(100.0)
        pauses.append(station.next_probe_at - 100.0)
    assert pauses == [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 55.0, 55.0]
    station.sync_rejections = 2
    station.mark_online(verified=True)
    assert station.sync_rejections == 0
    station.mark_offline(200.0)
    assert station.next_probe_at == 201.0


def test_probes_of_offline_stations_use_a_tenth_of_the_bus() -> None:
    budget = ProbeBudget()
    budget.spend(0.5, 10.0)
    assert budget.allowed_at == pytest.approx(14.5)


def probed(*due: int, due_until: float = 20.0) -> list[int]:
    """Return the numbers of the next two sync probes at 10 s, which read one, two and three registers in turn.

    ``due``: register counts of the reads without a reply, whose replies may come until then.
    """
    config = replace(station_config(), sync_request=lambda n: modbus.ReadRegisters(1, n, 1 + n % 3))
    station = Station(config, SETTINGS)
    for count in due:
        station.remember_unanswered(modbus.ReadRegisters(1, 0x3000, count), due_until - 5.0, due_until - 5.0)
    return [station.next_sync_request(10.0).register for _ in range(2)]


def test_a_sync_probe_whose_reply_has_the_length_of_one_that_is_due_is_left_out() -> None:
    assert probed() == [0, 1]
    assert probed(4) == [0, 1]
    assert probed(1) == [1, 2]
    assert probed(1, due_until=10.0) == [0, 1], "that reply can no longer come"
    assert probed(1, 2) == [0, 2], "the first two do not differ"


def test_a_request_is_forgotten_when_its_reply_can_no_longer_come() -> None:
    station = make_station()
    for now in (1.0, 6.0):
        station.remember_unanswered(now, now, now)
    assert [entry.request for entry in station.unanswered_requests] == [6.0]
