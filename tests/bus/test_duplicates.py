"""F15, F01: second answers to one request, as of two drives at one address, on a line polled without a pause."""

from __future__ import annotations

import random
from collections.abc import Iterable
from itertools import pairwise

import pytest

from drivebus.bus import Poll
from drivebus.bus.station import DUPLICATE_WINDOW_S
from drivebus.protocols import modbus
from drivebus.serial_settings import StationTiming
from drivebus.testing.bus_script import BusScript
from fixtures.bus import (
    CHARACTER_S,
    CODEC,
    SETTINGS,
    FakeStation,
    make_core,
    make_script,
    read,
    read_request,
    stop_request,
    whole,
    wire_to,
)


def reply(number: int) -> bytes:
    return CODEC.encode_reply(modbus.RegisterValues(1, 3, (number,) * 4))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("skew_s", [0.01, 0.1])
def test_a_second_answer_is_believed_once_at_most(seed: int, skew_s: float) -> None:
    """One reply in ten is heard twice on a port without pacing: what that pushes out is taken for no other's answer."""
    chance, station, copies = random.Random(seed), FakeStation(delay_s=0.004), 0

    def doubled(said: bytes, begins_at: float) -> Iterable[tuple[float, bytes]]:
        nonlocal copies
        yield from whole(said, begins_at)
        if chance.random() < 0.1:
            copies += 1
            yield from whole(said, begins_at + len(said) * CHARACTER_S + chance.random() * skew_s)

    answers = wire_to(station, deliver=doubled)
    made: dict[float, int] = {}

    def lines(frame: bytes, ended_at: float) -> Iterable[tuple[float, bytes]]:
        heard = list(answers(frame, ended_at))
        made[round(ended_at - SETTINGS.seconds(len(frame)), 9)] = station.read_count
        return heard

    play = BusScript(make_core(1, has_line_timing=False), lines)
    play.submit(read_request(), "first")
    play.run_until(0.5)
    play.receive(reply(1))  # now it is known to answer twice
    play.run_until(1)
    copies = 0
    play.start_polling(1, [Poll(read(), 0.0)])
    play.run_until(60)
    good = [answer for answer in play.results["polls"] if answer.error is None]
    wrong = [answer for answer in good if answer.reply.values[0] != made[round(answer.sent_at or 0, 9)]]
    assert copies > 80 and len(good) > 800
    assert len(wrong) <= copies


def twice_answered(delay_s: float = 0.005) -> BusScript:
    """A station that has answered two requests, both twice; two seconds on."""
    play = make_script(FakeStation(delay_s=delay_s), has_line_timing=False, timing=StationTiming(reply_delay_s=1.0))
    for number in (1, 2):
        play.submit(read_request(), number)
        play.run_until(play.now + 1)
        play.receive(reply(number))
        play.run_until(play.now + 2)
    return play


def test_what_a_second_answer_pushed_out_is_not_taken_for_the_next() -> None:
    """Once a station has answered twice, the answer to its last request is given its time before it is asked again."""
    play = twice_answered()
    play.submit(read_request(), "robbed")
    play.submit(read_request(), "next")
    play.receive(reply(2), at=play.now + 9 * CHARACTER_S)
    play.run()
    assert play.results["robbed"][0].reply.values[0] == 2, "nothing tells the two apart"
    assert play.results["next"][0].reply.values[0] == 4
    assert play.core.stations[1].counters.events["duplicate"] == 3


def test_a_stop_does_not_wait_for_an_answer_that_was_pushed_out() -> None:
    """I3."""
    play = twice_answered()
    begun = play.now
    play.submit(read_request(), "robbed")
    play.submit(stop_request(), "stop")
    play.receive(reply(2), at=begun + 9 * CHARACTER_S)
    play.run_until(begun + 0.1)
    stop = CODEC.encode_request(stop_request().request)
    assert next(at for at, frame in play.sent if frame == stop) == pytest.approx(begun + 12.5 * CHARACTER_S)


def test_an_answer_that_was_pushed_out_is_waited_for_a_quarter_of_a_second_at_most() -> None:
    """A frame that waits for a second is told that the line does not fall silent."""
    play = twice_answered(delay_s=0.9)
    begun = play.now
    play.submit(read_request(), "robbed")
    play.submit(read_request(), "next")
    play.receive(reply(2), at=begun + 9 * CHARACTER_S)
    play.run_until(begun + 0.5)
    assert play.sent[-1][0] == pytest.approx(begun + 8 * CHARACTER_S + 0.25)


def test_second_answers_of_long_ago_slow_nothing_down() -> None:
    play = twice_answered()
    play.run_until(play.now + DUPLICATE_WINDOW_S)
    begun = play.now
    play.submit(read_request(), "robbed")
    play.submit(read_request(), "next")
    play.receive(reply(2), at=begun + 9 * CHARACTER_S)
    play.run_until(begun + 0.1)
    assert play.sent[-1][0] == pytest.approx(begun + 12.5 * CHARACTER_S)


@pytest.mark.parametrize("hinted", [True, False])
def test_a_late_answer_behind_garbage_of_an_answers_size_is_a_second_one_after_a_sign(hinted: bool) -> None:
    """F15: two drives whose answers collide, one of them heard again behind the other; once alone it proves nothing."""
    play = make_script(FakeStation(), has_line_timing=False)
    play.submit(read_request(), 1)
    play.run_until(1)
    if hinted:
        play.receive(reply(1))
    play.run_until(2)
    play.wire = lambda frame, ended_at: [(ended_at + 0.02, b"\x55" * 13), (ended_at + 0.05, reply(2))]
    play.submit(read_request(), 2)
    play.run_until(2.2)
    assert play.core.stations[1].counters.events["late"] == 1
    assert play.core.health(1, play.now).duplicate_address is hinted
    assert len(play.core.stations[1].duplicate_reply_times) == (2 if hinted else 0)


@pytest.mark.parametrize("heard", [0, 12])
def test_a_late_answer_after_less_than_an_answer_is_just_late(heard: int) -> None:
    play = make_script(FakeStation(), has_line_timing=False)
    play.submit(read_request(), 1)
    play.run_until(1)
    play.receive(reply(1))
    play.run_until(2)
    play.wire = lambda frame, ended_at: [(ended_at + 0.02, b"\x55" * heard), (ended_at + 0.1, reply(2))]
    play.submit(read_request(), 2)
    play.run_until(2.2)
    assert play.core.stations[1].counters.events["late"] == 1
    assert not play.core.health(1, play.now).duplicate_address


def test_a_station_that_answers_once_is_asked_again_after_the_gap() -> None:
    """However long its other answers took."""
    station = FakeStation(delay_s=0.018)
    play = make_script(station, has_line_timing=False)
    play.submit(read_request(), "slow")
    play.run()
    station.delay_s = 0.001
    for number in range(20):
        play.submit(read_request(), number)
    play.run()
    times = [at for at, _ in play.sent[1:]]
    assert [later - earlier for earlier, later in pairwise(times)] == pytest.approx([24.5 * CHARACTER_S + 0.001] * 19)
