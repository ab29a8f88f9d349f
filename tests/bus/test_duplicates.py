"""Second replies to one request, as of two drives at one address, on a bus polled without a pause."""

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
def test_a_second_reply_is_accepted_once_at_most(seed: int, skew_s: float) -> None:
    """A tenth of the replies comes twice on a port without line timing; none is accepted for another request."""
    chance, station, copies = random.Random(seed), FakeStation(delay_s=0.004), 0

    def doubled(reply_frame: bytes, begins_at: float) -> Iterable[tuple[float, bytes]]:
        nonlocal copies
        yield from whole(reply_frame, begins_at)
        if chance.random() < 0.1:
            copies += 1
            yield from whole(reply_frame, begins_at + len(reply_frame) * CHARACTER_S + chance.random() * skew_s)

    replies_to = wire_to(station, deliver=doubled)
    made: dict[float, int] = {}

    def lines(frame: bytes, ended_at: float) -> Iterable[tuple[float, bytes]]:
        received = list(replies_to(frame, ended_at))
        made[round(ended_at - SETTINGS.seconds(len(frame)), 9)] = station.read_count
        return received

    script = BusScript(make_core(1, has_line_timing=False), lines)
    script.submit(read_request(), "first")
    script.run_until(0.5)
    script.receive(reply(1))  # now it is known to reply twice
    script.run_until(1)
    copies = 0
    script.start_polling(1, [Poll(read(), 0.0)])
    script.run_until(60)
    accepted = [result for result in script.results["polls"] if result.error is None]
    wrong = [result for result in accepted if result.reply.values[0] != made[round(result.sent_at or 0, 9)]]
    assert copies > 80 and len(accepted) > 800
    assert len(wrong) <= copies


def twice_answered(delay_s: float = 0.005) -> BusScript:
    """Return a script two seconds after its station has replied twice to each of two requests."""
    script = make_script(FakeStation(delay_s=delay_s), has_line_timing=False, timing=StationTiming(reply_delay_s=1.0))
    for number in (1, 2):
        script.submit(read_request(), number)
        script.run_until(script.now + 1)
        script.receive(reply(number))
        script.run_until(script.now + 2)
    return script


def test_a_reply_that_a_second_reply_pushed_out_is_not_accepted_for_the_next_request() -> None:
    """After two duplicate replies the reply to the last request gets its time before the next request."""
    script = twice_answered()
    script.submit(read_request(), "delayed")
    script.submit(read_request(), "next")
    script.receive(reply(2), at=script.now + 9 * CHARACTER_S)
    script.run()
    assert script.results["delayed"][0].reply.values[0] == 2, "the two replies cannot be distinguished"
    assert script.results["next"][0].reply.values[0] == 4
    assert script.core.stations[1].counters.events["duplicate"] == 3


def test_a_stop_does_not_wait_for_a_reply_that_was_pushed_out() -> None:
    script = twice_answered()
    begun = script.now
    script.submit(read_request(), "delayed")
    script.submit(stop_request(), "stop")
    script.receive(reply(2), at=begun + 9 * CHARACTER_S)
    script.run_until(begun + 0.1)
    stop = CODEC.encode_request(stop_request().request)
    assert next(at for at, frame in script.sent if frame == stop) == pytest.approx(begun + 12.5 * CHARACTER_S)


def test_a_reply_that_was_pushed_out_is_waited_for_a_quarter_of_a_second_at_most() -> None:
    """A frame that waits for a second fails because the bus does not fall silent."""
    script = twice_answered(delay_s=0.9)
    begun = script.now
    script.submit(read_request(), "delayed")
    script.submit(read_request(), "next")
    script.receive(reply(2), at=begun + 9 * CHARACTER_S)
    script.run_until(begun + 0.5)
    assert script.sent[-1][0] == pytest.approx(begun + 8 * CHARACTER_S + 0.25)


def test_old_second_replies_delay_nothing() -> None:
    script = twice_answered()
    script.run_until(script.now + DUPLICATE_WINDOW_S)
    begun = script.now
    script.submit(read_request(), "delayed")
    script.submit(read_request(), "next")
    script.receive(reply(2), at=begun + 9 * CHARACTER_S)
    script.run_until(begun + 0.1)
    assert script.sent[-1][0] == pytest.approx(begun + 12.5 * CHARACTER_S)


@pytest.mark.parametrize("hinted", [True, False])
def test_a_late_reply_after_garbage_of_reply_size_is_a_second_reply(hinted: bool) -> None:
    """The replies of two drives collide and one is received after the damage; a single such case proves nothing."""
    script = make_script(FakeStation(), has_line_timing=False)
    script.submit(read_request(), 1)
    script.run_until(1)
    if hinted:
        script.receive(reply(1))
    script.run_until(2)
    script.wire = lambda frame, ended_at: [(ended_at + 0.02, b"\x55" * 13), (ended_at + 0.05, reply(2))]
    script.submit(read_request(), 2)
    script.run_until(2.2)
    assert script.core.stations[1].counters.events["late"] == 1
    assert script.core.health(1, script.now).duplicate_address is hinted
    assert len(script.core.stations[1].duplicate_reply_times) == (2 if hinted else 0)


@pytest.mark.parametrize("received", [0, 12])
def test_a_late_reply_after_less_than_a_reply_is_just_late(received: int) -> None:
    script = make_script(FakeStation(), has_line_timing=False)
    script.submit(read_request(), 1)
    script.run_until(1)
    script.receive(reply(1))
    script.run_until(2)
    script.wire = lambda frame, ended_at: [(ended_at + 0.02, b"\x55" * received), (ended_at + 0.1, reply(2))]
    script.submit(read_request(), 2)
    script.run_until(2.2)
    assert script.core.stations[1].counters.events["late"] == 1
    assert not script.core.health(1, script.now).duplicate_address


def test_a_station_that_replies_once_is_addressed_again_after_the_gap() -> None:
    """It is not delayed, however long its other replies took."""
    station = FakeStation(delay_s=0.018)
    script = make_script(station, has_line_timing=False)
    script.submit(read_request(), "slow")
    script.run()
    station.delay_s = 0.001
    for number in range(20):
        script.submit(read_request(), number)
    script.run()
    times = [at for at, _ in script.sent[1:]]
    assert [later - earlier for earlier, later in pairwise(times)] == pytest.approx([24.5 * CHARACTER_S + 0.001] * 19)


def test_the_reply_to_another_master_is_no_second_reply_of_a_station_that_has_sent_one() -> None:
    script = make_script(FakeStation())
    script.submit(read_request(), 1)
    script.run_until(1)
    script.receive(reply(1))
    script.run_until(3)
    script.submit(read_request(), 2)
    assert script.result(2).error is None
    foreign = modbus.ReadRegisters(1, 0x0100, 2)
    script.receive(CODEC.encode_request(foreign), at=script.now + 0.1)
    script.receive(CODEC.encode_reply(modbus.RegisterValues(1, 3, (1, 2))), at=script.now + 0.12)
    script.run_until(script.now + 0.2)
    assert script.core.counters.events == {"duplicate": 1, "foreign_request": 1, "foreign": 1}
    assert len(script.core.stations[1].duplicate_reply_times) == 1
