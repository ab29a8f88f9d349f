"""Presence of stations: offline drives use at most a tenth of the bus, the others keep their rate."""

from __future__ import annotations

from itertools import pairwise

import pytest

from drivebus.bus import Poll, Presence
from drivebus.bus.station import MAX_PROBE_INTERVAL_S
from drivebus.errors import NoReply
from drivebus.testing.bus_script import BusScript
from fixtures.bus import CHARACTER_S, TIMING, FakeStation, make_script, read, read_request


def full_bus(count: int = 31) -> tuple[BusScript, list[FakeStation]]:
    stations = [FakeStation(address=address) for address in range(1, count + 1)]
    script = make_script(*stations)
    for station in stations:
        script.start_polling(station.address, [Poll(read(station.address), 0.0)], station.address)
    return script, stations


def reads_of(stations: list[FakeStation]) -> int:
    return sum(station.read_count for station in stations)


@pytest.mark.parametrize("dead", [1, 2, 5, 15, 30])
def test_online_stations_keep_their_cycle_with_any_number_offline(dead: int) -> None:
    """The mean cycle of the other drives is at most 11.2 % longer than if they were alone."""
    script, stations = full_bus()
    script.run_until(20)
    for station in stations[:dead]:
        station.alive = False
    script.run_until(60)
    living = stations[dead:]
    before, begun = reads_of(living), script.now
    script.run_until(begun + 120)
    per_read = (script.now - begun) / (reads_of(living) - before)
    alone = 8 * CHARACTER_S + 0.005 + 13 * CHARACTER_S + 3.5 * CHARACTER_S
    assert per_read <= alone * 1.112
    for station in stations[:dead]:
        assert script.core.presence(station.address) is Presence.OFFLINE


@pytest.mark.parametrize("dead", [1, 5, 30])
def test_a_drive_that_comes_back_is_detected_within_its_bound(dead: int) -> None:
    """On a full bus it takes at most max(60 s, k probes at 10 % of the bus)."""
    script, stations = full_bus()
    script.run_until(10)
    for station in stations[:dead]:
        station.alive = False
    script.run_until(250)
    stations[0].alive = True
    back = script.now
    while script.core.presence(1) is not Presence.ONLINE:
        script.run_until(script.now + 0.5)
    probe = 8 * CHARACTER_S + TIMING.timeout_s(script.core.settings, 8) + 3.5 * CHARACTER_S
    assert script.now - back <= max(60.0, dead * probe / 0.1) + probe + 0.5
    script.run_until(script.now + 2)
    assert script.results[1][-1].error is None


def test_a_station_that_never_replied_is_never_seen_and_still_probed() -> None:
    station = FakeStation(alive=False)
    script = make_script(station)
    script.start_polling(1, [Poll(read(), 0.2)])
    script.run_until(30)
    assert script.core.presence(1) is Presence.NEVER_SEEN
    assert 4 <= len(script.sent) <= 8, "probes at 1, 2, 4, 8, 16 s"
    station.alive = True
    script.run_until(65)
    assert script.core.presence(1) is Presence.ONLINE
    assert script.results["polls"][-1].error is None


def test_probes_back_off_from_one_second_to_the_longest_pause() -> None:
    station = FakeStation()
    script = make_script(station)
    script.start_polling(1, [Poll(read(), 1.0, phase_s=0.0)])
    script.run_until(3.5)
    station.alive = False
    script.run_until(600)
    probes = [at for at, frame in script.sent if frame[1] == 8 and at > 4]
    pauses = [later - earlier for earlier, later in pairwise(probes)]
    assert pauses[:6] == pytest.approx([1, 2, 4, 8, 16, 32], abs=0.6)
    assert pauses[6:] == pytest.approx([MAX_PROBE_INTERVAL_S] * len(pauses[6:]), abs=0.6)


def test_a_drive_that_comes_back_just_after_a_probe_is_detected_within_a_minute() -> None:
    station = FakeStation()
    script = make_script(station)
    script.start_polling(1, [Poll(read(), 1.0, phase_s=0.0)])
    script.run_until(3.5)
    station.alive = False
    script.run_until(200)
    count = len(script.sent)
    while len(script.sent) == count:
        script.run_until(script.now + 0.001)
    script.run_until(script.now + 0.02)
    station.alive, back = True, script.now
    while script.core.presence(1) is not Presence.ONLINE:
        script.run_until(script.now + 0.01)
    assert MAX_PROBE_INTERVAL_S <= script.now - back <= 60.0


def test_polls_of_a_silent_station_are_not_sent() -> None:
    station = FakeStation()
    script = make_script(station)
    script.start_polling(1, [Poll(read(), 0.1)])
    script.run_until(2)
    station.alive = False
    script.run_until(4)
    count = len(script.sent)
    script.run_until(10)
    assert {frame[1] for frame in script.frames[count:]} == {8}


def test_a_request_to_an_offline_station_is_tried_at_once() -> None:
    """The sync probe is sent at once; after its reply the read is sent, otherwise it fails unsent."""
    station = FakeStation()
    script = make_script(station)
    script.submit(read_request(), "first")
    script.result("first")
    station.alive = False
    script.run_until(script.now + 1)
    script.submit(read_request(), "second")
    script.result("second")
    script.run_until(script.now + 200)
    submitted_at = script.now
    count = len(script.sent)
    script.submit(read_request(), "third")
    result = script.result("third")
    assert isinstance(result.error, NoReply) and result.sent == b"" and result.attempts == 0
    assert script.now - submitted_at < 0.1 and len(script.sent) == count + 1
    station.alive = True
    script.run_until(script.now + 1)
    script.submit(read_request(), "fourth")
    assert script.result("fourth").error is None


def test_a_never_seen_station_is_addressed_once_without_retry() -> None:
    """A scan must not wait twice for every empty address."""
    script = make_script(FakeStation(alive=False))
    script.submit(read_request())
    result = script.result()
    assert isinstance(result.error, NoReply) and result.attempts == 1 and len(script.sent) == 1


def test_health_counts_failures_of_the_last_minutes() -> None:
    station = FakeStation()
    script = make_script(station)
    for number in range(8):
        script.submit(read_request(), number)
        script.result(number)
    station.alive = False
    script.submit(read_request(), "lost")
    script.result("lost")
    health = script.core.health(1, script.now)
    assert health.error_rate == pytest.approx(2 / 10)
    assert health.presence is Presence.OFFLINE and health.suspect and not health.foreign_master
    assert health.last_reply_at is not None
    script.run_until(script.now + 5)
    station.alive = True
    script.run_until(script.now + 700)
    assert script.core.health(1, script.now).error_rate < 0.1
