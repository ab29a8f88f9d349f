"""Never seen, online, silent: dead drives get a tenth of the bus at most, the others keep their rate (F11, G08)."""

from __future__ import annotations

from itertools import pairwise

import pytest

from drivebus.bus import Poll, Presence
from drivebus.bus.station import MAX_PROBE_INTERVAL_S
from drivebus.errors import NoReply
from drivebus.testing.bus_script import BusScript
from fixtures.bus import CHARACTER_S, TIMING, FakeStation, make_script, read, read_request


def full_bus(count: int = 31) -> tuple[BusScript, list[FakeStation]]:
    stations = [FakeStation(address) for address in range(1, count + 1)]
    play = make_script(*stations)
    for station in stations:
        play.start_polling(station.address, [Poll(read(station.address), 0.0)], station.address)
    return play, stations


def reads_of(stations: list[FakeStation]) -> int:
    return sum(station.read_count for station in stations)


@pytest.mark.parametrize("dead", [1, 2, 5, 15, 30])
def test_the_living_keep_their_cycle_with_any_number_dead(dead: int) -> None:
    """G08: the mean cycle of the living is at most 11.2 % longer than if they were alone."""
    play, stations = full_bus()
    play.run_until(20)
    for station in stations[:dead]:
        station.alive = False
    play.run_until(60)
    living = stations[dead:]
    before, begun = reads_of(living), play.now
    play.run_until(begun + 120)
    per_read = (play.now - begun) / (reads_of(living) - before)
    alone = 8 * CHARACTER_S + 0.005 + 13 * CHARACTER_S + 3.5 * CHARACTER_S
    assert per_read <= alone * 1.112
    for station in stations[:dead]:
        assert play.core.presence(station.address) is Presence.OFFLINE


@pytest.mark.parametrize("dead", [1, 5, 30])
def test_a_drive_that_comes_back_is_found_within_its_bound(dead: int) -> None:
    """G08: recovery at most max(60 s, k probes at 10 % of the bus), on a bus that is full."""
    play, stations = full_bus()
    play.run_until(10)
    for station in stations[:dead]:
        station.alive = False
    play.run_until(250)
    stations[0].alive = True
    back = play.now
    while play.core.presence(1) is not Presence.ONLINE:
        play.run_until(play.now + 0.5)
    probe = 8 * CHARACTER_S + TIMING.timeout_s(play.core.settings, 8) + 3.5 * CHARACTER_S
    assert play.now - back <= max(60.0, dead * probe / 0.1) + probe + 0.5
    play.run_until(play.now + 2)
    assert play.results[1][-1].error is None


def test_a_station_that_never_answered_is_never_seen_and_still_looked_for() -> None:
    station = FakeStation(alive=False)
    play = make_script(station)
    play.start_polling(1, [Poll(read(), 0.2)])
    play.run_until(30)
    assert play.core.presence(1) is Presence.NEVER_SEEN
    assert 4 <= len(play.sent) <= 8, "probes at 1, 2, 4, 8, 16 s"
    station.alive = True
    play.run_until(65)
    assert play.core.presence(1) is Presence.ONLINE
    assert play.results["polls"][-1].error is None


def test_probes_back_off_from_one_second_to_the_longest_pause() -> None:
    station = FakeStation()
    play = make_script(station)
    play.start_polling(1, [Poll(read(), 1.0, phase_s=0.0)])
    play.run_until(3.5)
    station.alive = False
    play.run_until(600)
    probes = [at for at, frame in play.sent if frame[1] == 8 and at > 4]
    pauses = [later - earlier for earlier, later in pairwise(probes)]
    assert pauses[:6] == pytest.approx([1, 2, 4, 8, 16, 32], abs=0.6)
    assert pauses[6:] == pytest.approx([MAX_PROBE_INTERVAL_S] * len(pauses[6:]), abs=0.6)


def test_g08_a_drive_that_comes_back_just_after_a_probe_is_found_within_a_minute() -> None:
    station = FakeStation()
    play = make_script(station)
    play.start_polling(1, [Poll(read(), 1.0, phase_s=0.0)])
    play.run_until(3.5)
    station.alive = False
    play.run_until(200)
    count = len(play.sent)
    while len(play.sent) == count:
        play.run_until(play.now + 0.001)
    play.run_until(play.now + 0.02)
    station.alive, back = True, play.now
    while play.core.presence(1) is not Presence.ONLINE:
        play.run_until(play.now + 0.01)
    assert MAX_PROBE_INTERVAL_S <= play.now - back <= 60.0


def test_polls_of_a_silent_station_are_not_sent() -> None:
    station = FakeStation()
    play = make_script(station)
    play.start_polling(1, [Poll(read(), 0.1)])
    play.run_until(2)
    station.alive = False
    play.run_until(4)
    count = len(play.sent)
    play.run_until(10)
    assert {frame[1] for frame in play.frames[count:]} == {8}


def test_somebody_who_asks_a_silent_station_is_answered_at_once() -> None:
    """The fence goes out for him; if it is answered his read follows, else he is told, and nothing else was sent."""
    station = FakeStation()
    play = make_script(station)
    play.submit(read_request(), "first")
    play.result("first")
    station.alive = False
    play.run_until(play.now + 1)
    play.submit(read_request(), "second")
    play.result("second")
    play.run_until(play.now + 200)
    asked = play.now
    count = len(play.sent)
    play.submit(read_request(), "third")
    answer = play.result("third")
    assert isinstance(answer.error, NoReply) and answer.sent == b"" and answer.attempts == 0
    assert play.now - asked < 0.1 and len(play.sent) == count + 1
    station.alive = True
    play.run_until(play.now + 1)
    play.submit(read_request(), "fourth")
    assert play.result("fourth").error is None


def test_a_never_seen_station_is_asked_once_without_retry() -> None:
    """A scan must not wait twice for every empty address."""
    play = make_script(FakeStation(alive=False))
    play.submit(read_request())
    answer = play.result()
    assert isinstance(answer.error, NoReply) and answer.attempts == 1 and len(play.sent) == 1


def test_health_counts_failures_of_the_last_minutes() -> None:
    station = FakeStation()
    play = make_script(station)
    for number in range(8):
        play.submit(read_request(), number)
        play.result(number)
    station.alive = False
    play.submit(read_request(), "lost")
    play.result("lost")
    health = play.core.health(1, play.now)
    assert health.error_rate == pytest.approx(2 / 10)
    assert health.presence is Presence.OFFLINE and health.suspect and not health.foreign_master
    assert health.last_reply_at is not None
    play.run_until(play.now + 5)
    station.alive = True
    play.run_until(play.now + 700)
    assert play.core.health(1, play.now).error_rate < 0.1
