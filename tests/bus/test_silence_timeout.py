"""Bus that is never silent: a frame that waits in vain fails after its time, and the next one has its turn."""

from __future__ import annotations

from dataclasses import replace

import pytest

from drivebus.bus.core import BusCore
from drivebus.errors import LineError
from drivebus.testing.bus_script import BusScript
from fixtures.bus import (
    CHARACTER_S,
    SETTINGS,
    TIMING,
    FakeStation,
    make_core,
    make_script,
    read_request,
    station_config,
    stop_request,
    wire_to,
)

GAP_S = 3.5 * CHARACTER_S


def make_noise(script: BusScript, seconds: float, every_s: float = 2 * CHARACTER_S) -> None:
    """Let bytes come with pauses that are shorter than the gap, from now on."""
    for number in range(int(seconds / every_s)):
        script.receive(b"\x55", at=script.now + number * every_s)


def test_a_frame_without_silence_fails_after_one_second_and_the_next_one_a_second_later() -> None:
    script = BusScript(make_core(1))
    script.run_until(1.0)
    make_noise(script, 5.0)
    script.run_until(2.0)
    for token in ("first", "second"):
        script.submit(read_request(), token)
    for count, token in enumerate(("first", "second"), 1):
        error = script.result(token).error
        assert isinstance(error, LineError) and error.key == "bus.no_silence" and error.params["seconds"] == 1.0
        assert script.now == pytest.approx(2.0 + count, abs=0.02)
        assert script.core.counters.events["no_silence"] == count
    assert not script.sent


def test_after_a_frame_has_failed_for_lack_of_silence_the_bus_wakes_up_a_gap_later() -> None:
    script = BusScript(make_core(1))
    script.run_until(1.0)
    make_noise(script, 5.0)
    script.run_until(1.1)
    script.submit(read_request())
    script.result()
    assert script.core.wake_at == pytest.approx(script.now + GAP_S)


def test_a_sync_probe_without_silence_fails_the_requests_that_wait_for_it() -> None:
    station = FakeStation()
    script = make_script(station)
    script.submit(read_request())
    script.result()
    station.alive = False
    script.submit(read_request(), "lost")
    script.run_until(script.now + 0.1)
    make_noise(script, 5.0)
    count, suspect_since = len(script.sent), script.core.stations[1].suspect_since
    error = script.result("lost").error
    assert isinstance(error, LineError) and error.key == "bus.no_silence" and len(script.sent) == count
    assert script.core.stations[1].suspect_since > suspect_since, "its quarantine begins again"
    assert script.now == pytest.approx(suspect_since + TIMING.max_reply_lateness_s + 1.0, abs=0.01)


def test_the_time_waited_before_a_frame_that_was_sent_does_not_count_for_the_next_one() -> None:
    """The second drive needs a longer gap, so noise can come between the reply of the first and its request."""
    core = make_core(1)
    core.registry.add(station_config(2, replace(TIMING, gap_characters=20)))
    script = BusScript(core, wire_to(FakeStation(address=1), FakeStation(address=2)))
    script.run_until(1.0)
    make_noise(script, 0.9)
    script.run_until(1.01)
    for address in (1, 2):
        script.submit(read_request(address), address)
    assert script.result(1).error is None and len(script.sent) == 1
    make_noise(script, 0.5)
    assert script.result(2).error is None


def test_the_time_waited_before_a_frame_that_was_withdrawn_does_not_count_for_the_next_one() -> None:
    script = make_script(FakeStation())
    script.run_until(1.0)
    make_noise(script, 0.9)
    script.run_until(1.01)
    script.submit(read_request(), "withdrawn")
    script.run_until(1.85)
    script._perform(script.core.cancel("withdrawn", script.now))
    script.run_until(2.0)
    make_noise(script, 0.5)
    script.run_until(2.01)
    script.submit(read_request(), "next")
    assert script.result("next").error is None


def test_a_stop_is_sent_64_characters_and_its_gap_after_it_was_requested() -> None:
    script = BusScript(make_core(1))
    script.run_until(1.0)
    make_noise(script, 1.0, every_s=CHARACTER_S / 8)
    script.run_until(1.1)
    script.submit(stop_request())
    script.run_until(1.3)
    assert script.sent[0][0] == pytest.approx(1.1 + GAP_S + 64 * CHARACTER_S, abs=CHARACTER_S / 8)


def test_bytes_on_a_bus_without_stations_are_a_frame_after_three_and_a_half_characters() -> None:
    core = BusCore(SETTINGS, has_line_timing=True)
    script = BusScript(core)
    script.core.tracing = True
    for number in range(4):
        script.receive(b"\x55", at=1.0 + number * 3 * CHARACTER_S)
    script.run_until(1.0 + 9 * CHARACTER_S)
    assert core.wake_at == pytest.approx(1.0 + 9 * CHARACTER_S + GAP_S)
    script.run()
    assert [event.data for event in script.traced] == [b"\x55" * 4]


def test_a_request_that_follows_noise_is_sent_in_the_same_moment_in_which_the_noise_is_classified() -> None:
    script = make_script(FakeStation())
    script.run_until(1.0)
    script.receive(b"\x55", at=1.0)
    script.run_until(1.0)
    script.submit(read_request())
    assert script.core.wake_at == pytest.approx(1.0 + GAP_S) and not script.sent
    script._step(script.core.wake_at)
    assert len(script.sent) == 1


def test_bytes_while_no_frame_waits_are_one_frame_up_to_the_longest_gap_of_all_stations() -> None:
    core = make_core(1)
    core.registry.add(station_config(2, replace(TIMING, gap_characters=20)))
    script = BusScript(core)
    core.tracing = True
    for number in range(4):
        script.receive(b"\x55", at=1.0 + number * 15 * CHARACTER_S)
    script.run_until(2.0)
    assert [event.data for event in script.traced] == [b"\x55" * 4]
