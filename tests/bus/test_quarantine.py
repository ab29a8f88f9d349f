"""After a timeout: quarantine, fence, and no late reply ever credited to another request (F01, G04, ruling 2 and 3)."""

from __future__ import annotations

import random
from collections.abc import Iterable
from dataclasses import replace

import pytest

from drivebus.bus import Poll, Presence
from drivebus.bus.core import BusCore
from drivebus.errors import NoReply
from drivebus.protocols import modbus
from drivebus.testing.bus_script import BusScript
from fixtures.bus import (
    CHARACTER_S,
    CODEC,
    DELIVERIES,
    SETTINGS,
    TIMING,
    FakeStation,
    byte_by_byte,
    make_core,
    make_script,
    read,
    read_request,
    station_config,
    whole,
    wire_to,
)

TIMEOUT = TIMING.timeout_s(SETTINGS, 13)


def test_after_a_timeout_the_station_rests_and_answers_a_fence_before_it_is_asked_again() -> None:
    station = FakeStation()
    play = make_script(station)
    play.submit(read_request(), "first")
    play.result("first")
    station.alive = False
    play.submit(read_request(), "second")
    sent_at = play.now
    play.run_until(sent_at + 0.1)
    station.alive = True
    answer = play.result("second")
    assert answer.error is None and answer.attempts == 2
    (lost_at, lost), (fence_at, fence), (_, again) = play.sent[1:]
    assert fence[1] == 8 and again == lost
    assert fence_at - lost_at == pytest.approx(8 * CHARACTER_S + TIMEOUT + TIMING.max_reply_lateness_s)


def test_the_others_are_served_while_one_is_in_quarantine() -> None:
    stations = [FakeStation(1), FakeStation(2)]
    play = make_script(*stations)
    for address in (1, 2):
        play.submit(read_request(address), address)
    play.result(2)
    stations[0].alive = False
    play.submit(read_request(1), "lost")
    play.run_until(play.now + 0.1)
    play.submit(read_request(2), "other")
    asked = play.now
    assert play.result("other").error is None
    assert play.now - asked < 0.05


def test_a_late_reply_is_not_credited_to_the_next_request() -> None:
    """F01 as pymodbus' own test has it: the answer to the first read comes while the second one is out."""
    station = FakeStation()
    play = make_script(station)
    play.submit(read_request(), "first")
    play.result("first")
    station.alive = False
    play.submit(read_request(register=0x1000), "a")
    play.submit(read_request(register=0x2002), "b")
    late_at = play.now + TIMEOUT + 0.02
    play.receive(CODEC.encode_reply(modbus.RegisterValues(1, 3, (666,) * 4)), at=late_at)
    play.run_until(late_at + 0.01)
    station.alive = True
    for token in ("a", "b"):
        assert 666 not in play.result(token).reply.values
    assert play.core.counters.events["late"] == 1


def test_a_late_reply_heard_during_another_stations_turn_is_counted_late() -> None:
    stations = [FakeStation(1), FakeStation(2, delay_s=0.019)]
    play = make_script(*stations)
    for address in (1, 2):
        play.submit(read_request(address), address)
    play.result(2)
    stations[0].alive = False
    play.submit(read_request(1), "lost")
    play.run_until(play.now + 0.075)
    play.submit(read_request(2), "other")
    play.receive(CODEC.encode_reply(modbus.RegisterValues(1, 3, (666,) * 4)), at=play.now + 8 * CHARACTER_S + 0.0145)
    assert play.result("other").reply.values[0] != 666
    assert play.core.counters.events.get("late") == 1
    assert play.core.stations[1].counters.events == {"late": 1}


def test_an_unanswered_fence_makes_the_station_silent_and_tells_who_waits() -> None:
    station = FakeStation()
    play = make_script(station)
    play.submit(read_request(), "first")
    play.result("first")
    station.alive = False
    play.submit(read_request(), "second")
    answer = play.result("second")
    assert isinstance(answer.error, NoReply) and answer.error.key == "bus.offline"
    assert play.core.presence(1) is Presence.OFFLINE


def test_two_fences_in_a_row_are_never_the_same() -> None:
    station = FakeStation()
    play = make_script(station)
    play.submit(read_request(), "first")
    play.result("first")
    station.alive = False
    play.run_until(play.now + 1)
    play.submit(read_request(), "second")
    play.run_until(play.now + 20)
    fences = [frame for frame in play.frames if frame[1] == 8]
    assert len(fences) >= 4 and len(set(fences)) == len(fences)


def test_the_answer_to_the_wrong_question_makes_suspect_not_wise() -> None:
    """The count differs: an older answer; the true one is still on its way, so no retry before the fence."""
    station = FakeStation()
    play = make_script(station)
    play.submit(read_request(), "first")
    play.result("first")
    station.alive = False
    play.submit(read_request(count=2), "second")
    play.receive(
        CODEC.encode_reply(modbus.RegisterValues(1, 3, (6, 6, 6, 6))), at=play.now + 8 * CHARACTER_S + 20 * CHARACTER_S
    )
    play.run_until(play.now + 0.06)
    assert play.core.stations[1].state.is_suspect and len(play.sent) == 2


def counting() -> BusCore:
    """A DF800 as the bus sees it: nothing but a count tells its fence from other reads."""
    bus = BusCore(SETTINGS, echo="off")
    bus.add_station(replace(station_config(1), sync_request=lambda n: read(1, 0x3000 + 2 * (n % 8), 2)))
    return bus


def registers(*values: int) -> bytes:
    return CODEC.encode_reply(modbus.RegisterValues(1, 3, values))


def test_the_late_answer_to_somebodys_own_question_is_not_taken_for_a_fences() -> None:
    """G04, ruling 2: a user's read of two registers times out; its answer comes while the fence, of two as well, waits.

    Found by the campaign ``late`` (seed 1, df800-rtu/10): only older fences were remembered, not older questions.
    """
    station = FakeStation()
    play = BusScript(counting(), wire_to(station))
    play.submit(read_request(count=4), "first")
    play.result("first")
    station.alive = False
    play.submit(read_request(register=0x3020, count=2), "own")
    asked_at = play.now
    play.run_until(asked_at + 8 * CHARACTER_S + TIMEOUT + TIMING.max_reply_lateness_s + 0.001)
    fence_at, fence = play.sent[2]
    assert fence[1] == 3 and fence[5] == 2
    play.receive(registers(7, 7), at=fence_at + 8 * CHARACTER_S + 0.01)
    play.run_until(fence_at + 0.09)
    assert play.core.stations[1].state.is_suspect
    station.alive = True
    play.run_until(fence_at + 5.0)
    assert len(play.sent) == 3, "a fence proves nothing while its own answer may still come as well"
    play.run_until(fence_at + 5.3)
    assert not play.core.stations[1].state.is_suspect and play.sent[3][0] > fence_at + 5.0


def test_the_late_answer_to_a_fence_that_was_not_believed_is_not_taken_for_the_next_ones() -> None:
    """The second fence got the first one's answer; its own still comes, and must not pass for the third one's."""
    station = FakeStation()
    play = BusScript(counting(), wire_to(station))
    play.submit(read_request(count=4), "first")
    play.result("first")
    station.alive = False
    play.submit(read_request(count=4), "lost")
    play.run_until(play.now + 0.5)
    while len(play.sent) < 4:
        play.run_until(play.now + 0.002)
    second_at = play.sent[3][0]
    play.receive(registers(7, 7), at=second_at + 8 * CHARACTER_S + 0.01)
    play.run_until(second_at + 4.9)
    assert len(play.sent) == 4 and play.core.stations[1].state.is_suspect
    station.alive = True
    play.run_until(second_at + 6.0)
    assert not play.core.stations[1].state.is_suspect and play.sent[4][0] > second_at + 5.0


class LateStation(FakeStation):
    """Answers in order; some answers come too late, up to ``longest_s``."""

    def __init__(self, address: int, chance: random.Random, share: float, longest_s: float) -> None:
        super().__init__(address)
        self.chance, self.share, self.longest_s, self.free_at = chance, share, longest_s, 0.0

    def speak(self, frame: bytes, ended_at: float) -> Iterable[tuple[float, bytes]]:
        reply = self.reply_to(frame, ended_at)
        if reply is None:
            return []
        begins = ended_at + (self.chance.random() * self.longest_s if self.chance.random() < self.share else 0.004)
        begins = max(begins, self.free_at)
        pieces = list((whole if self.chance.random() < 0.5 else byte_by_byte)(reply, begins))
        self.free_at = pieces[-1][0] + 4 * CHARACTER_S
        return pieces


@pytest.mark.parametrize(
    ("share", "longest_s", "seed"), [(0.01, 0.3, 4), (0.05, 0.3, 8), (0.2, 0.3, 23), (0.2, 5.0, 70), (0.2, 1.0, 3)]
)
@pytest.mark.parametrize(("paced", "fence"), [(True, "nonce"), (False, "nonce"), (False, "count")])
def test_no_late_answer_is_ever_misattributed(
    share: float, longest_s: float, paced: bool, fence: str, seed: int
) -> None:
    """G04 in small: same-shaped reads back to back, each value names its request; lateness up to 5 s, in order.

    Fences of VC660 (a loop-back with a nonce) and of DF800 (a read whose count differs). Seed 70 with counts once took
    the late answer of an older fence for a newer one's; seed 3 repeated a read at once whose garbage was another's.
    """
    chance = random.Random(seed)
    stations = [LateStation(address, chance, share, longest_s) for address in (1, 2, 3)]
    for station in stations:
        station.registers = {register: register for register in range(0x3000, 0x3040)}

    def line(frame: bytes, ended_at: float) -> Iterable[tuple[float, bytes]]:
        return [piece for station in stations for piece in station.speak(frame, ended_at)]

    bus = BusCore(SETTINGS, has_line_timing=paced, echo="off")
    for station in stations:
        one = station_config(station.address)
        counting = replace(one, sync_request=lambda n, a=station.address: read(a, 0x3000 + 2 * (n % 8), 2))
        bus.add_station(one if fence == "nonce" else counting)
    play = BusScript(bus, line)
    asked: dict[int, int] = {}
    for number in range(2500):
        register = 0x3000 + 4 * chance.randrange(16)
        asked[number] = register
        play.submit(read_request(1 + number % 3, register), number)
        if number % 5 == 4:
            play.result(number)
    play.run_until(play.now + 60)
    answered = 0
    for number, register in asked.items():
        reply = play.results[number][0].reply
        if reply is not None:
            answered += 1
            assert reply.values == tuple(range(register, register + 4)), number
    assert answered > (1500 if longest_s < 1 else 40)


@pytest.mark.parametrize("line", DELIVERIES)
def test_polls_keep_coming_on_every_line(line: str) -> None:
    stations = [FakeStation(1), FakeStation(2)]
    play = make_script(*stations, deliver=DELIVERIES[line]())
    for station in stations:
        play.start_polling(station.address, [Poll(read(station.address), 0.1)], station.address)
    play.run_until(60)
    for station in stations:
        good = [answer for answer in play.results[station.address] if answer.error is None]
        assert len(good) > (550 if line in ("clean", "byte by byte") else 100)


def test_two_answers_in_one_window_hint_at_a_duplicate_address() -> None:
    """F15."""

    def twice(reply: bytes, begins_at: float) -> Iterable[tuple[float, bytes]]:
        yield from byte_by_byte(reply, begins_at)
        yield from byte_by_byte(reply, begins_at + (len(reply) + 2) * CHARACTER_S)

    play = BusScript(make_core(1), wire_to(FakeStation(), deliver=twice))
    for number in range(3):
        play.submit(read_request(), number)
        play.result(number)
    assert play.core.health(1, play.now).duplicate_address
    assert play.core.counters.events["duplicate"] >= 2
    assert all(play.results[number][0].reply is None for number in range(3))


def test_a_refused_fence_proves_nothing_until_it_was_refused_three_times() -> None:
    """An error reply echoes only the function, so an older error would pass for it; but a drive that knows no such
    request must not be lost for ever."""
    station = FakeStation()
    play = make_script(station)
    play.submit(read_request(), "first")
    play.result("first")
    play.wire = lambda frame, ended: []
    play.submit(read_request(), "second")
    play.run_until(play.now + 0.1)
    inner = wire_to(station)

    def refuses_loopbacks(frame: bytes, ended: float) -> Iterable[tuple[float, bytes]]:
        if frame[1] == 8:
            return [(ended + 0.02, CODEC.encode_reply(modbus.ExceptionReply(1, 8, 1)))]
        return inner(frame, ended)

    play.wire = refuses_loopbacks
    assert play.result("second").error is None
    assert [frame[1] for frame in play.frames] == [3, 3, 8, 8, 8, 3]
