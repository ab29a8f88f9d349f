"""A stop is the next frame (I3, F17), deletes what it overtakes, and is held back by nothing but the wire itself."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest

from buskit import (
    CODEC,
    LINE,
    LINES,
    STOP,
    TIMING,
    C,
    Station,
    ask_read,
    ask_start,
    ask_stop,
    ask_write,
    book,
    core,
    link,
    read,
    wire,
)  # fmt: skip
from drivebus.bus import Poll, arithmetic
from drivebus.errors import NotPermitted, Superseded
from drivebus.message import Ask, Effect, Lane, WriteClass
from drivebus.protocols import modbus
from drivebus.testing.playbook import Playbook

STOP_FRAME = CODEC.encode_request(ask_stop().request)


@pytest.mark.parametrize("line", LINES)
def test_a_stop_is_the_next_frame_on_every_line(line: str) -> None:
    stations = [Station(address) for address in (1, 2, 3)]
    play = book(*stations, deliver=LINES[line]())
    for address in (1, 2, 3):
        play.watch(address, [Poll(read(address), 0.0)], f"w{address}")
    chance = random.Random(7)
    for number in range(60):
        play.until(play.now + chance.random())
        for other in range(5):
            play.ask(ask_read(2), (number, other))
        before = len(play.sent)
        play.ask(ask_stop(1), number)
        play.until(play.now + 0.5)
        assert play.sent[before][1] == STOP_FRAME


def test_at_any_instant_of_a_full_bus_with_silent_stations_a_stop_leaves_within_its_bound() -> None:
    """G06 in virtual time, against the arithmetic of RELIABILITY 5.1 (no host time: there is none here)."""
    stations = [Station(address, delay_s=0.019) for address in range(1, 6)]
    play = book(*stations)
    plan = [(link(address), [Poll(read(address), 0.0)]) for address in range(1, 6)]
    for one, polls in plan:
        play.watch(one.address, polls, one.address)
    bound = arithmetic(plan, LINE).drives[1].stop_bound_s
    chance = random.Random(3)
    worst = 0.0
    for number in range(1500):
        stations[3].alive = chance.random() < 0.9
        stations[0].alive = chance.random() < 0.9
        play.until(play.now + chance.random() * 0.3)
        for other in range(3):
            play.ask(ask_read(2 + other), "reads")
        before, asked = len(play.sent), play.now
        play.ask(ask_stop(1), number)
        play.until(asked + 0.5)
        at, frame = play.sent[before]
        assert frame == STOP_FRAME
        worst = max(worst, at + 8 * C - asked)
    assert worst <= bound + 1e-6
    assert worst > 0.7 * bound, "the bound is tight enough to be worth something"


def test_a_start_whose_gap_is_being_waited_out_is_overtaken_and_deleted() -> None:
    station = Station()
    play = book(station)
    play.ask(ask_read(), "read")
    play.answer("read")
    play.hear(b"\x55")
    play.until(play.now + C)
    play.ask(ask_start(play.core), "start")
    assert "start" not in play.answers
    play.ask(ask_stop(), "stop")
    assert isinstance(play.answers["start"][0].error, Superseded)
    assert play.answers["start"][0].sent == b""
    play.until(play.now + 1)
    assert station.started == 0 and station.registers[0x2000] == STOP


def test_a_stop_deletes_its_stations_commands_and_nobody_elses() -> None:
    stations = [Station(1), Station(2)]
    play = book(*stations)
    for address in (1, 2):
        play.ask(ask_read(address), address)
    play.answer(2)
    play.ask(ask_read(2), "busy")
    play.ask(ask_write(play.core, 1), "setpoint 1")
    play.ask(ask_start(play.core, 1), "start 1")
    play.ask(ask_start(play.core, 2), "start 2")
    play.ask(ask_read(1), "read 1")
    play.ask(ask_stop(1), "stop 1")
    play.until(play.now + 1)
    assert isinstance(play.answers["setpoint 1"][0].error, Superseded)
    assert isinstance(play.answers["start 1"][0].error, Superseded)
    assert play.answers["start 2"][0].error is None and play.answers["read 1"][0].error is None
    assert [station.started for station in stations] == [0, 1]


def test_permits_from_before_a_stop_are_void_after_it() -> None:
    """6.5: after a stop a start needs a new user action."""
    play = book(Station())
    play.ask(ask_read(), "read")
    play.answer("read")
    old = ask_start(play.core)
    play.ask(ask_stop(), "stop")
    play.answer("stop")
    play.ask(old, "old")
    error = play.answer("old").error
    assert isinstance(error, NotPermitted) and error.key == "bus.permit_stopped"
    play.ask(ask_start(play.core), "new")
    assert play.answer("new").error is None


def test_a_stop_in_any_lane_is_a_stop() -> None:
    play = book(Station(1), Station(2))
    play.ask(ask_read(2), "busy")
    play.until(0.01)
    for number in range(3):
        play.ask(ask_write(play.core, 2), number)
    play.ask(Ask(1, ask_stop().request, Lane.POLL, WriteClass.ABSOLUTE), "stop")
    play.answer("stop")
    assert play.frames[1] == STOP_FRAME


def test_i3_what_follows_a_stop_lets_the_other_drives_stops_go_first() -> None:
    """VC660 writes the levels after each stop pulse: asked for in the command lane, still ahead of everything else."""
    play = book(Station(1), Station(2))
    play.ask(ask_read(1), "in flight")
    play.until(0.01)
    play.ask(ask_read(2), "read")
    play.ask(replace(ask_stop(1), lane=Lane.COMMAND), "levels of 1")
    play.ask(ask_stop(2), "stop of 2")
    play.play()
    stop_1, stop_2 = (CODEC.encode_request(ask_stop(address).request) for address in (1, 2))
    assert play.frames[1:3] == [stop_2, stop_1]


def test_nothing_else_may_use_the_stop_lane() -> None:
    play = book(Station(1), Station(2))
    play.ask(ask_read(2), "busy")
    play.until(0.01)
    play.ask(ask_write(play.core, 2, lane=Lane.COMMAND), "command")
    play.ask(ask_read(1, lane=Lane.STOP), "smuggled")
    play.answer("smuggled")
    assert play.frames[1] != CODEC.encode_request(read(1))


def test_a_stop_goes_to_a_station_in_quarantine_and_its_reply_is_not_believed() -> None:
    """5.3: sending is always allowed, only believing is delayed."""
    station = Station()
    play = book(station)
    play.ask(ask_read(), "first")
    play.answer("first")
    station.alive = False
    play.ask(ask_read(), "lost")
    play.until(play.now + 0.1)
    assert play.core.stations[1].suspect
    station.alive = True
    play.ask(ask_stop(), "stop")
    answer = play.answer("stop")
    assert station.registers[0x2000] == STOP
    assert answer.reply is None and answer.error is not None and answer.error.key == "bus.suspect"
    assert answer.attempts == 1


def test_an_unanswered_stop_is_resent_twice_after_the_other_drives_stops() -> None:
    """F17: never given up at once, and never in the way of the next drive's stop."""
    stations = [Station(1), Station(2)]
    play = book(*stations)
    for address in (1, 2):
        play.ask(ask_read(address), address)
    play.answer(2)
    stations[0].alive = False
    play.sent.clear()
    play.ask(ask_stop(1), "one")
    play.ask(ask_stop(2), "two")
    assert play.answer("one").attempts == 3
    assert [frame[0] for frame in play.frames] == [1, 2, 1, 1]


def test_a_broadcast_stop_waits_the_turnaround_for_no_reply_and_is_never_repeated() -> None:
    """F10: no answer, no retry, all drives."""
    stations = [Station(1), Station(2)]
    play = book(*stations)
    play.until(1.0)
    queued = ask_start(play.core, 2)
    play.ask(ask_read(1), "busy")
    play.ask(queued, "start")
    play.ask(Ask(0, modbus.WriteRegister(0, 0x2000, STOP), Lane.STOP, WriteClass.BROADCAST), "all")
    answer = play.answer("all")
    assert answer.reply is None and answer.error is None and answer.attempts == 1
    assert play.now == pytest.approx((answer.sent_at or 0) + 8 * C + TIMING.turnaround_s)
    assert isinstance(play.answers["start"][0].error, Superseded)
    assert [station.registers[0x2000] for station in stations] == [STOP, STOP]
    assert [play.core.stations[address].generation for address in (1, 2)] == [1, 1]


def test_nothing_but_a_stop_is_ever_broadcast() -> None:
    play = book(Station())
    for register, value in ((0x2000, 1), (0x2001, 5000)):
        play.ask(Ask(0, modbus.WriteRegister(0, register, value)), register)
        error = play.answer(register).error
        assert isinstance(error, NotPermitted) and error.key == "bus.broadcast"
    assert play.sent == []


def test_g06_a_stop_waits_for_each_other_drive_once_and_for_no_repetition() -> None:
    """Whoever repeats the stop of a dead drive, others several times that of a living one: a new stop is soon out."""
    play = book(Station(1, alive=False), Station(2), Station(3))
    play.ask(ask_stop(1), "first of 1")
    play.until(0.01)
    for number in range(6):
        play.ask(ask_stop(1), f"1 again, {number}")
        play.ask(ask_stop(2), f"2 again, {number}")
    play.ask(ask_stop(3), "stop of 3")
    play.until(1.0)
    stops = [frame[0] for frame in play.frames]
    assert stops[:4] == [1, 2, 3, 1]


def test_a_word_that_stops_one_model_and_starts_another_is_not_broadcast() -> None:
    """2000H of VC660 and DF800: the same bit is a stop here and a run there."""
    bus = core(1)
    other = link(2)
    bus.add(type(other)(2, other.codec, other.timing, lambda frame: Effect.MOTION, other.fence))
    play = Playbook(bus, wire(Station(1)))
    play.ask(Ask(0, modbus.WriteRegister(0, 0x2000, STOP), Lane.STOP), "all")
    error = play.answer("all").error
    assert isinstance(error, NotPermitted) and error.params["station"] == 2


def test_a_babbling_line_does_not_hold_back_a_stop() -> None:
    play = Playbook(core(1))
    play.until(1.0)
    for place in range(4000):
        play.hear(b"\x55", at=1.0 + place * 2 * C)
    play.until(1.5)
    play.ask(ask_read(), "read")
    play.ask(ask_stop(), "stop")
    asked = play.now
    play.until(asked + 0.2)
    at, frame = play.sent[0]
    assert frame == STOP_FRAME and at - asked <= 68 * C
    play.until(asked + 4)
    assert play.answers["read"][0].error is not None and play.answers["read"][0].error.key == "bus.no_silence"
