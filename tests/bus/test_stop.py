"""A stop is the next frame (I3, F17), deletes what it overtakes, and is held back by nothing but the wire itself."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest

from drivebus.bus import Poll, estimate_bus_load
from drivebus.bus.messages import BusRequest, RequestPriority, RetryPolicy
from drivebus.errors import NotPermitted, Superseded
from drivebus.protocols import modbus
from drivebus.protocols.codec import Effect
from drivebus.testing.bus_script import BusScript
from fixtures.bus import (
    CHARACTER_S,
    CODEC,
    DELIVERIES,
    SETTINGS,
    STOP,
    TIMING,
    FakeStation,
    make_core,
    make_script,
    read,
    read_request,
    start_request,
    station_config,
    stop_request,
    wire_to,
    write_request,
)

STOP_FRAME = CODEC.encode_request(stop_request().request)


@pytest.mark.parametrize("line", DELIVERIES)
def test_a_stop_is_the_next_frame_on_every_line(line: str) -> None:
    stations = [FakeStation(address) for address in (1, 2, 3)]
    play = make_script(*stations, deliver=DELIVERIES[line]())
    for address in (1, 2, 3):
        play.start_polling(address, [Poll(read(address), 0.0)], f"w{address}")
    chance = random.Random(7)
    for number in range(60):
        play.run_until(play.now + chance.random())
        for other in range(5):
            play.submit(read_request(2), (number, other))
        before = len(play.sent)
        play.submit(stop_request(1), number)
        play.run_until(play.now + 0.5)
        assert play.sent[before][1] == STOP_FRAME


def test_at_any_instant_of_a_full_bus_with_silent_stations_a_stop_leaves_within_its_bound() -> None:
    """G06 in virtual time, against the arithmetic of RELIABILITY 5.1 (no host time: there is none here)."""
    stations = [FakeStation(address, delay_s=0.019) for address in range(1, 6)]
    play = make_script(*stations)
    plan = [(station_config(address), [Poll(read(address), 0.0)]) for address in range(1, 6)]
    for one, polls in plan:
        play.start_polling(one.address, polls, one.address)
    bound = estimate_bus_load(plan, SETTINGS).drives[1].stop_bound_s
    chance = random.Random(3)
    worst = 0.0
    for number in range(1500):
        stations[3].alive = chance.random() < 0.9
        stations[0].alive = chance.random() < 0.9
        play.run_until(play.now + chance.random() * 0.3)
        for other in range(3):
            play.submit(read_request(2 + other), "reads")
        before, asked = len(play.sent), play.now
        play.submit(stop_request(1), number)
        play.run_until(asked + 0.5)
        at, frame = play.sent[before]
        assert frame == STOP_FRAME
        worst = max(worst, at + 8 * CHARACTER_S - asked)
    assert worst <= bound + 1e-6
    assert worst > 0.7 * bound, "the bound is tight enough to be worth something"


def test_a_start_whose_gap_is_being_waited_out_is_overtaken_and_deleted() -> None:
    station = FakeStation()
    play = make_script(station)
    play.submit(read_request(), "read")
    play.result("read")
    play.receive(b"\x55")
    play.run_until(play.now + CHARACTER_S)
    play.submit(start_request(play.core), "start")
    assert "start" not in play.results
    play.submit(stop_request(), "stop")
    assert isinstance(play.results["start"][0].error, Superseded)
    assert play.results["start"][0].sent == b""
    play.run_until(play.now + 1)
    assert station.start_count == 0 and station.registers[0x2000] == STOP


def test_a_stop_deletes_its_stations_commands_and_nobody_elses() -> None:
    stations = [FakeStation(1), FakeStation(2)]
    play = make_script(*stations)
    for address in (1, 2):
        play.submit(read_request(address), address)
    play.result(2)
    play.submit(read_request(2), "busy")
    play.submit(write_request(play.core, 1), "setpoint 1")
    play.submit(start_request(play.core, 1), "start 1")
    play.submit(start_request(play.core, 2), "start 2")
    play.submit(read_request(1), "read 1")
    play.submit(stop_request(1), "stop 1")
    play.run_until(play.now + 1)
    assert isinstance(play.results["setpoint 1"][0].error, Superseded)
    assert isinstance(play.results["start 1"][0].error, Superseded)
    assert play.results["start 2"][0].error is None and play.results["read 1"][0].error is None
    assert [station.start_count for station in stations] == [0, 1]


def test_permits_from_before_a_stop_are_void_after_it() -> None:
    """6.5: after a stop a start needs a new user action."""
    play = make_script(FakeStation())
    play.submit(read_request(), "read")
    play.result("read")
    old = start_request(play.core)
    play.submit(stop_request(), "stop")
    play.result("stop")
    play.submit(old, "old")
    error = play.result("old").error
    assert isinstance(error, NotPermitted) and error.key == "bus.permit_stopped"
    play.submit(start_request(play.core), "new")
    assert play.result("new").error is None


def test_a_stop_in_any_lane_is_a_stop() -> None:
    play = make_script(FakeStation(1), FakeStation(2))
    play.submit(read_request(2), "busy")
    play.run_until(0.01)
    for number in range(3):
        play.submit(write_request(play.core, 2), number)
    play.submit(BusRequest(1, stop_request().request, RequestPriority.POLL, RetryPolicy.IDEMPOTENT), "stop")
    play.result("stop")
    assert play.frames[1] == STOP_FRAME


def test_i3_what_follows_a_stop_lets_the_other_drives_stops_go_first() -> None:
    """VC660 writes the levels after each stop pulse: asked for in the command lane, still ahead of everything else."""
    play = make_script(FakeStation(1), FakeStation(2))
    play.submit(read_request(1), "in flight")
    play.run_until(0.01)
    play.submit(read_request(2), "read")
    play.submit(replace(stop_request(1), priority=RequestPriority.COMMAND), "levels of 1")
    play.submit(stop_request(2), "stop of 2")
    play.run()
    stop_1, stop_2 = (CODEC.encode_request(stop_request(address).request) for address in (1, 2))
    assert play.frames[1:3] == [stop_2, stop_1]


def test_nothing_else_may_use_the_stop_lane() -> None:
    play = make_script(FakeStation(1), FakeStation(2))
    play.submit(read_request(2), "busy")
    play.run_until(0.01)
    play.submit(write_request(play.core, 2, priority=RequestPriority.COMMAND), "command")
    play.submit(read_request(1, priority=RequestPriority.STOP), "smuggled")
    play.result("smuggled")
    assert play.frames[1] != CODEC.encode_request(read(1))


def test_a_stop_goes_to_a_station_in_quarantine_and_its_reply_is_not_believed() -> None:
    """5.3: sending is always allowed, only believing is delayed."""
    station = FakeStation()
    play = make_script(station)
    play.submit(read_request(), "first")
    play.result("first")
    station.alive = False
    play.submit(read_request(), "lost")
    play.run_until(play.now + 0.1)
    assert play.core.stations[1].state.is_suspect
    station.alive = True
    play.submit(stop_request(), "stop")
    answer = play.result("stop")
    assert station.registers[0x2000] == STOP
    assert answer.reply is None and answer.error is not None and answer.error.key == "bus.suspect"
    assert answer.attempts == 1


def test_an_unanswered_stop_is_resent_twice_after_the_other_drives_stops() -> None:
    """F17: never given up at once, and never in the way of the next drive's stop."""
    stations = [FakeStation(1), FakeStation(2)]
    play = make_script(*stations)
    for address in (1, 2):
        play.submit(read_request(address), address)
    play.result(2)
    stations[0].alive = False
    play.sent.clear()
    play.submit(stop_request(1), "one")
    play.submit(stop_request(2), "two")
    assert play.result("one").attempts == 3
    assert [frame[0] for frame in play.frames] == [1, 2, 1, 1]


def test_a_broadcast_stop_waits_the_turnaround_for_no_reply_and_is_never_repeated() -> None:
    """F10: no answer, no retry, all drives."""
    stations = [FakeStation(1), FakeStation(2)]
    play = make_script(*stations)
    play.run_until(1.0)
    queued = start_request(play.core, 2)
    play.submit(read_request(1), "busy")
    play.submit(queued, "start")
    play.submit(
        BusRequest(0, modbus.WriteRegister(0, 0x2000, STOP), RequestPriority.STOP, RetryPolicy.BROADCAST), "all"
    )
    answer = play.result("all")
    assert answer.reply is None and answer.error is None and answer.attempts == 1
    assert play.now == pytest.approx((answer.sent_at or 0) + 8 * CHARACTER_S + TIMING.turnaround_s)
    assert isinstance(play.results["start"][0].error, Superseded)
    assert [station.registers[0x2000] for station in stations] == [STOP, STOP]
    assert [play.core.stations[address].stop_epoch for address in (1, 2)] == [1, 1]


def test_nothing_but_a_stop_is_ever_broadcast() -> None:
    play = make_script(FakeStation())
    for register, value in ((0x2000, 1), (0x2001, 5000)):
        play.submit(BusRequest(0, modbus.WriteRegister(0, register, value)), register)
        error = play.result(register).error
        assert isinstance(error, NotPermitted) and error.key == "bus.broadcast"
    assert play.sent == []


def test_g06_a_stop_waits_for_each_other_drive_once_and_for_no_repetition() -> None:
    """Whoever repeats the stop of a dead drive, others several times that of a living one: a new stop is soon out."""
    play = make_script(FakeStation(1, alive=False), FakeStation(2), FakeStation(3))
    play.submit(stop_request(1), "first of 1")
    play.run_until(0.01)
    for number in range(6):
        play.submit(stop_request(1), f"1 again, {number}")
        play.submit(stop_request(2), f"2 again, {number}")
    play.submit(stop_request(3), "stop of 3")
    play.run_until(1.0)
    stops = [frame[0] for frame in play.frames]
    assert stops[:4] == [1, 2, 3, 1]


def test_a_word_that_stops_one_model_and_starts_another_is_not_broadcast() -> None:
    """2000H of VC660 and DF800: the same bit is a stop here and a run there."""
    bus = make_core(1)
    other = station_config(2)
    bus.add_station(replace(other, effect_of=lambda frame: Effect.MOTION))
    play = BusScript(bus, wire_to(FakeStation(1)))
    play.submit(BusRequest(0, modbus.WriteRegister(0, 0x2000, STOP), RequestPriority.STOP), "all")
    error = play.result("all").error
    assert isinstance(error, NotPermitted) and error.params["station"] == 2


def test_a_babbling_line_does_not_hold_back_a_stop() -> None:
    play = BusScript(make_core(1))
    play.run_until(1.0)
    for place in range(4000):
        play.receive(b"\x55", at=1.0 + place * 2 * CHARACTER_S)
    play.run_until(1.5)
    play.submit(read_request(), "read")
    play.submit(stop_request(), "stop")
    asked = play.now
    play.run_until(asked + 0.2)
    at, frame = play.sent[0]
    assert frame == STOP_FRAME and at - asked <= 68 * CHARACTER_S
    play.run_until(asked + 4)
    assert play.results["read"][0].error is not None and play.results["read"][0].error.key == "bus.no_silence"
