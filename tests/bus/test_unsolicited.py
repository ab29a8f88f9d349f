"""Bytes that nobody asked for: late, second, foreign, noise. Counted by kind, never applied (F14, F15, I12)."""

from __future__ import annotations

import random

import pytest

from drivebus import profiles
from drivebus.bus import TraceKind
from drivebus.bus.core import BusCore
from drivebus.bus.messages import BusRequest
from drivebus.bus.station import StationState
from drivebus.drives.dialects.base import StopMode
from drivebus.drives.dialects.create import create_dialect
from drivebus.protocols import modbus
from drivebus.testing.bus_script import BusScript
from fixtures.bus import CHARACTER_S, CODEC, SETTINGS, FakeStation, make_core, make_script, read, read_request


def test_two_foreign_requests_mean_a_foreign_master_and_a_minute_of_peace_ends_it() -> None:
    """G18: flagged after two frames."""
    play = BusScript(make_core(1))
    play.run_until(1.0)
    frame = CODEC.encode_request(modbus.ReadRegisters(17, 0x100, 2))
    play.receive(frame, at=1.1)
    play.run_until(1.2)
    assert not play.core.health(1, play.now).foreign_master
    play.receive(frame, at=1.3)
    play.run_until(1.4)
    assert play.core.health(1, play.now).foreign_master
    assert play.core.counters.events["foreign_request"] == 2
    play.run_until(70)
    assert not play.core.health(1, play.now).foreign_master


def test_a_second_drivebus_that_sends_our_own_frames_is_a_foreign_master() -> None:
    play = make_script(FakeStation())
    play.submit(read_request())
    play.result()
    for number in range(2):
        play.receive(CODEC.encode_request(read()), at=play.now + 0.1 + 0.1 * number)
    play.run_until(play.now + 0.5)
    assert play.core.health(1, play.now).foreign_master


def test_the_answer_to_a_foreign_request_is_not_called_a_duplicate() -> None:
    play = make_script(FakeStation())
    play.submit(read_request())
    play.result()
    for number in range(4):
        at = play.now + 0.1
        play.receive(CODEC.encode_request(read()), at=at)
        play.receive(CODEC.encode_reply(modbus.RegisterValues(1, 3, (number,) * 4)), at=at + CHARACTER_S)
        play.run_until(at + 0.1)
    health = play.core.health(1, play.now)
    assert health.foreign_master and not health.duplicate_address


def test_a_station_that_answers_unasked_shows_another_master_while_we_wait() -> None:
    play = BusScript(make_core(1))
    for number in range(2):
        play.run_until(play.now + 1)
        play.submit(read_request(), number)
        play.receive(CODEC.encode_reply(modbus.RegisterValues(99, 3, (1, 1, 1, 1))), at=play.now + 0.03)
        play.result(number)
    assert play.core.health(1, play.now).foreign_master


def test_a_second_answer_while_idle_is_counted_and_makes_suspect() -> None:
    play = make_script(FakeStation())
    play.core.tracing = True
    play.submit(read_request())
    answer = play.result()
    play.receive(answer.received, at=play.now + 0.05)
    play.run_until(play.now + 0.1)
    assert play.core.counters.events["duplicate"] == 1
    assert play.core.stations[1].state.is_suspect
    assert [event.kind for event in play.traced] == [TraceKind.SENT, TraceKind.REPLY, TraceKind.DUPLICATE]
    play.run_until(play.now + 2)
    assert not play.core.stations[1].state.is_suspect, "its fence was answered"


def test_noise_is_counted_and_forgotten() -> None:
    play = make_script(FakeStation())
    for number in range(50):
        play.receive(b"\xff\x00", at=number * 0.1)
    play.run_until(10)
    assert play.core.counters.events == {"unsolicited": 50}
    assert len(play.core.unsolicited.buffer) == 0
    play.submit(read_request())
    assert play.result().error is None


def test_unasked_bytes_never_grow_beyond_their_bound() -> None:
    """I12."""
    play = BusScript(make_core(1))
    chance = random.Random(1)
    at = 0.0
    for _ in range(3000):
        at += CHARACTER_S
        play.receive(chance.randbytes(8), at=at)
    play.run_until(at)
    assert len(play.core.unsolicited.buffer) <= 512


def test_the_gap_counts_from_the_last_byte_heard_whoever_sent_it() -> None:
    """F08: foreign traffic ends, then 3.5 characters, then we."""
    play = make_script(FakeStation())
    play.run_until(1.0)
    play.receive(b"\x55")
    play.run_until(1.0 + CHARACTER_S)
    play.receive(b"\x55")
    play.submit(read_request())
    play.result()
    assert play.sent[0][0] == pytest.approx(1.0 + CHARACTER_S + 3.5 * CHARACTER_S)


def test_a_foreign_request_that_comes_while_we_wait_is_recognised() -> None:
    """G18 on a busy bus, where nobody is ever idle."""
    play = BusScript(make_core(1))
    foreign = CODEC.encode_request(modbus.ReadRegisters(9, 0x100, 2))
    for number in range(2):
        play.run_until(play.now + 2)
        play.submit(read_request(), number)
        play.receive(foreign, at=play.now + 0.03)
        play.result(number)
    assert play.core.health(1, play.now).foreign_master


@pytest.mark.parametrize("waiting", [True, False])
def test_f01_a_late_mirrored_answer_is_late_and_no_foreign_master(waiting: bool) -> None:
    """The answer of FC06 is a valid request: from a station that owes us one it is its answer, whenever it comes."""
    play = BusScript(make_core(1))
    late = CODEC.encode_reply(modbus.WriteAck(1, 6, 0x2001, 1000))
    play.submit(read_request())
    for _ in range(3):
        play.core.stations[1].state = StationState.SUSPECT
        if waiting:
            play.run_until(play.now + 1)
            play.receive(late, at=play.now + 0.001)
        else:
            play.receive(late, at=play.now + 1)
        play.run_until(play.now + 1)
    assert not play.core.health(1, play.now).foreign_master
    assert play.core.counters.events["late"] >= 2
    assert "foreign_request" not in play.core.counters.events


@pytest.mark.parametrize("model", ["c320", "dzb100", "vc660", "df800"])
@pytest.mark.parametrize("address", [1, 2])
@pytest.mark.parametrize("waiting", [True, False])
def test_f14_a_foreign_master_is_heard_in_every_family_also_while_a_station_owes_an_answer(
    model: str, address: int, waiting: bool
) -> None:
    """I8: its request may be for the very station that is silent; no bytes whatever may end the bus."""
    ours, stranger = (create_dialect(profiles.load(model), one) for one in (1, address))
    bus = BusCore(SETTINGS, echo="off")
    bus.add_station(ours.station_config)
    play = BusScript(bus)
    play.submit(BusRequest(1, ours.echo_test_read()), "silent")
    play.result("silent")
    assert bus.stations[1].state.is_suspect
    foreign = stranger.codec.encode_request(stranger.echo_test_read())
    for _ in range(2):
        if waiting:
            play.submit(BusRequest(1, ours.stop(StopMode.STOP)[0]), "stop")
            play.run_until(play.now + 0.05)
        play.receive(foreign)
        play.run_until(play.now + 2.0)
    assert bus.health(1, play.now).foreign_master
