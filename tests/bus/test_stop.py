"""A stop is the next frame, removes overtaken commands, and waits only for the frame on the wire."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest

from drivebus.bus import Poll, estimate_bus_load
from drivebus.bus.messages import BusRequest, RequestPriority
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
    effect,
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
def test_a_stop_is_the_next_frame_of_every_family(line: str) -> None:
    stations = [FakeStation(address=address) for address in (1, 2, 3)]
    script = make_script(*stations, deliver=DELIVERIES[line]())
    for address in (1, 2, 3):
        script.start_polling(address, [Poll(read(address), 0.0)], f"w{address}")
    chance = random.Random(7)
    for number in range(60):
        script.run_until(script.now + chance.random())
        for other in range(5):
            script.submit(read_request(2), (number, other))
        before = len(script.sent)
        script.submit(stop_request(1), number)
        script.run_until(script.now + 0.5)
        assert script.sent[before][1] == STOP_FRAME


def test_at_any_instant_of_a_full_bus_with_silent_stations_a_stop_leaves_within_its_bound() -> None:
    """The delay is within the computed stop bound without host time, because time is virtual."""
    stations = [FakeStation(address=address, delay_s=0.019) for address in range(1, 6)]
    script = make_script(*stations)
    plan = [(station_config(address), [Poll(read(address), 0.0)]) for address in range(1, 6)]
    for config, station_polls in plan:
        script.start_polling(config.address, station_polls, config.address)
    bound = estimate_bus_load(plan, SETTINGS).drives[1].stop_bound_s
    chance = random.Random(3)
    worst = 0.0
    for number in range(1500):
        stations[3].alive = chance.random() < 0.9
        stations[0].alive = chance.random() < 0.9
        script.run_until(script.now + chance.random() * 0.3)
        for other in range(3):
            script.submit(read_request(2 + other), "reads")
        before, submitted_at = len(script.sent), script.now
        script.submit(stop_request(1), number)
        script.run_until(submitted_at + 0.5)
        at, frame = script.sent[before]
        assert frame == STOP_FRAME
        worst = max(worst, at + 8 * CHARACTER_S - submitted_at)
    assert worst <= bound + 1e-6
    assert worst > 0.7 * bound, "the bound is not far above the worst case"


def test_a_start_that_waits_for_its_gap_is_overtaken_and_deleted() -> None:
    station = FakeStation()
    script = make_script(station)
    script.submit(read_request(), "read")
    script.result("read")
    script.receive(b"\x55")
    script.run_until(script.now + CHARACTER_S)
    script.submit(start_request(script.core), "start")
    assert "start" not in script.results
    script.submit(stop_request(), "stop")
    assert isinstance(script.results["start"][0].error, Superseded)
    assert script.results["start"][0].sent == b""
    script.run_until(script.now + 1)
    assert station.start_count == 0 and station.registers[0x2000] == STOP


def test_a_stop_deletes_its_stations_commands_and_no_others() -> None:
    stations = [FakeStation(address=1), FakeStation(address=2)]
    script = make_script(*stations)
    for address in (1, 2):
        script.submit(read_request(address), address)
    script.result(2)
    script.submit(read_request(2), "busy")
    script.submit(write_request(script.core, 1), "setpoint 1")
    script.submit(start_request(script.core, 1), "start 1")
    script.submit(start_request(script.core, 2), "start 2")
    script.submit(read_request(1), "read 1")
    script.submit(stop_request(1), "stop 1")
    script.run_until(script.now + 1)
    assert isinstance(script.results["setpoint 1"][0].error, Superseded)
    assert isinstance(script.results["start 1"][0].error, Superseded)
    assert script.results["start 2"][0].error is None and script.results["read 1"][0].error is None
    assert [station.start_count for station in stations] == [0, 1]


def test_permits_from_before_a_stop_are_invalid_after_it() -> None:
    """After a stop a start needs a new user action."""
    script = make_script(FakeStation())
    script.submit(read_request(), "read")
    script.result("read")
    old = start_request(script.core)
    script.submit(stop_request(), "stop")
    script.result("stop")
    script.submit(old, "old")
    error = script.result("old").error
    assert isinstance(error, NotPermitted) and error.key == "bus.permit_stopped"
    script.submit(start_request(script.core), "new")
    assert script.result("new").error is None


def test_a_stop_in_any_priority_is_a_stop() -> None:
    script = make_script(FakeStation(address=1), FakeStation(address=2))
    script.submit(read_request(2), "busy")
    script.run_until(0.01)
    for number in range(3):
        script.submit(write_request(script.core, 2), number)
    script.submit(
        BusRequest(
            station=1,
            request=stop_request().request,
            priority=RequestPriority.POLL,
        ),
        "stop",
    )
    script.result("stop")
    assert script.frames[1] == STOP_FRAME


def test_frames_after_a_stop_wait_for_the_stops_of_other_drives() -> None:
    """VC660 writes the levels after each stop pulse: as commands they are still sent first."""
    script = make_script(FakeStation(address=1), FakeStation(address=2))
    script.submit(read_request(1), "in transaction")
    script.run_until(0.01)
    script.submit(read_request(2), "read")
    script.submit(replace(stop_request(1), priority=RequestPriority.COMMAND), "levels of 1")
    script.submit(stop_request(2), "stop of 2")
    script.run()
    stop_1, stop_2 = (CODEC.encode_request(stop_request(address).request) for address in (1, 2))
    assert script.frames[1:3] == [stop_2, stop_1]


def test_nothing_else_may_use_the_stop_priority() -> None:
    script = make_script(FakeStation(address=1), FakeStation(address=2))
    script.submit(read_request(2), "busy")
    script.run_until(0.01)
    script.submit(write_request(script.core, 2, priority=RequestPriority.COMMAND), "command")
    script.submit(read_request(1, priority=RequestPriority.STOP), "smuggled")
    script.result("smuggled")
    assert script.frames[1] != CODEC.encode_request(read(1))


def test_a_stop_goes_to_a_station_in_quarantine_and_its_reply_is_not_accepted() -> None:
    """A stop may always be sent, only its reply is not accepted."""
    station = FakeStation()
    script = make_script(station)
    script.submit(read_request(), "first")
    script.result("first")
    station.alive = False
    script.submit(read_request(), "lost")
    script.run_until(script.now + 0.1)
    assert script.core.stations[1].state.is_suspect
    station.alive = True
    script.submit(stop_request(), "stop")
    result = script.result("stop")
    assert station.registers[0x2000] == STOP
    assert result.reply is None and result.error is not None and result.error.key == "bus.suspect"
    assert result.attempts == 1


def test_an_unanswered_stop_is_resent_twice_after_the_other_drives_stops() -> None:
    """It is repeated, and never before the stop of the next drive."""
    stations = [FakeStation(address=1), FakeStation(address=2)]
    script = make_script(*stations)
    for address in (1, 2):
        script.submit(read_request(address), address)
    script.result(2)
    stations[0].alive = False
    script.sent.clear()
    script.submit(stop_request(1), "stop")
    script.submit(stop_request(2), "two")
    assert script.result("stop").attempts == 3
    assert [frame[0] for frame in script.frames] == [1, 2, 1, 1]


def test_a_broadcast_stop_waits_the_turnaround_for_no_reply_and_is_never_repeated() -> None:
    """No reply, no retry, all drives."""
    stations = [FakeStation(address=1), FakeStation(address=2)]
    script = make_script(*stations)
    script.run_until(1.0)
    queued = start_request(script.core, 2)
    script.submit(read_request(1), "busy")
    script.submit(queued, "start")
    script.submit(
        BusRequest(
            station=0,
            request=modbus.WriteRegister(0, 0x2000, STOP),
            priority=RequestPriority.STOP,
        ),
        "all",
    )
    result = script.result("all")
    assert result.reply is None and result.error is None and result.attempts == 1
    assert script.now == pytest.approx((result.sent_at or 0) + 8 * CHARACTER_S + TIMING.turnaround_s)
    assert isinstance(script.results["start"][0].error, Superseded)
    assert [station.registers[0x2000] for station in stations] == [STOP, STOP]
    assert [script.core.stations[address].stop_epoch for address in (1, 2)] == [1, 1]


def test_nothing_but_a_stop_is_ever_broadcast() -> None:
    script = make_script(FakeStation())
    for register, value in ((0x2000, 1), (0x2001, 5000)):
        script.submit(BusRequest(station=0, request=modbus.WriteRegister(0, register, value)), register)
        error = script.result(register).error
        assert isinstance(error, NotPermitted) and error.key == "bus.broadcast"
    assert script.sent == []


def test_a_stop_waits_for_each_other_drive_once_and_for_no_repetition() -> None:
    """A new stop is sent soon, while stops of a silent drive and of another drive are repeated."""
    script = make_script(FakeStation(address=1, alive=False), FakeStation(address=2), FakeStation(address=3))
    script.submit(stop_request(1), "first of 1")
    script.run_until(0.01)
    for number in range(6):
        script.submit(stop_request(1), f"1 again, {number}")
        script.submit(stop_request(2), f"2 again, {number}")
    script.submit(stop_request(3), "stop of 3")
    script.run_until(1.0)
    stops = [frame[0] for frame in script.frames]
    assert stops[:4] == [1, 2, 3, 1]


def test_a_station_whose_sync_request_does_more_than_read_is_rejected() -> None:
    bus = make_core(2)
    starting = replace(station_config(1), sync_request=lambda n: modbus.WriteRegister(1, 0x2000, 1))
    with pytest.raises(ValueError, match="a sync request only reads, this one is motion"):
        bus.registry.add(starting)


def test_a_control_word_that_stops_one_model_and_starts_another_is_not_broadcast() -> None:
    """Word 2 at register 2000H is a stop on a VC660 and a start on a DF800."""
    bus = make_core(1)
    other = station_config(2)
    bus.registry.add(
        replace(other, effect_of=lambda frame: Effect.MOTION if effect(frame) is Effect.STOP else Effect.NONE)
    )
    script = BusScript(bus, wire_to(FakeStation(address=1)))
    script.submit(
        BusRequest(station=0, request=modbus.WriteRegister(0, 0x2000, STOP), priority=RequestPriority.STOP), "all"
    )
    error = script.result("all").error
    assert isinstance(error, NotPermitted) and error.params["station"] == 2


def test_a_line_that_is_never_silent_does_not_delay_a_stop() -> None:
    script = BusScript(make_core(1))
    script.run_until(1.0)
    for place in range(4000):
        script.receive(b"\x55", at=1.0 + place * 2 * CHARACTER_S)
    script.run_until(1.5)
    script.submit(read_request(), "read")
    script.submit(stop_request(), "stop")
    submitted_at = script.now
    script.run_until(submitted_at + 0.2)
    at, frame = script.sent[0]
    assert frame == STOP_FRAME and at - submitted_at <= 68 * CHARACTER_S
    script.run_until(submitted_at + 4)
    assert script.results["read"][0].error is not None and script.results["read"][0].error.key == "bus.no_silence"
