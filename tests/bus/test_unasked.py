"""Bytes that nobody asked for: late, second, foreign, noise. Counted by kind, never applied (F14, F15, I12)."""

from __future__ import annotations

import random

import pytest

from buskit import CODEC, LINE, C, Station, ask_read, book, core, read
from drivebus import profiles
from drivebus.bus import Kind
from drivebus.bus.core import BusCore
from drivebus.drives.dialect import Stop
from drivebus.drives.make import make_dialect
from drivebus.message import Ask
from drivebus.protocols import modbus
from drivebus.testing.playbook import Playbook


def test_two_foreign_requests_mean_a_foreign_master_and_a_minute_of_peace_ends_it() -> None:
    """G18: flagged after two frames."""
    play = Playbook(core(1))
    play.until(1.0)
    frame = CODEC.encode_request(modbus.ReadRegisters(17, 0x100, 2))
    play.hear(frame, at=1.1)
    play.until(1.2)
    assert not play.core.health(1, play.now).foreign_master
    play.hear(frame, at=1.3)
    play.until(1.4)
    assert play.core.health(1, play.now).foreign_master
    assert play.core.counters.kinds["master"] == 2
    play.until(70)
    assert not play.core.health(1, play.now).foreign_master


def test_a_second_drivebus_that_sends_our_own_frames_is_a_foreign_master() -> None:
    play = book(Station())
    play.ask(ask_read())
    play.answer()
    for number in range(2):
        play.hear(CODEC.encode_request(read()), at=play.now + 0.1 + 0.1 * number)
    play.until(play.now + 0.5)
    assert play.core.health(1, play.now).foreign_master


def test_the_answer_to_a_foreign_request_is_not_called_a_duplicate() -> None:
    play = book(Station())
    play.ask(ask_read())
    play.answer()
    for number in range(4):
        at = play.now + 0.1
        play.hear(CODEC.encode_request(read()), at=at)
        play.hear(CODEC.encode_reply(modbus.Registers(1, 3, (number,) * 4)), at=at + C)
        play.until(at + 0.1)
    health = play.core.health(1, play.now)
    assert health.foreign_master and not health.duplicate


def test_a_station_that_answers_unasked_shows_another_master_while_we_wait() -> None:
    play = Playbook(core(1))
    for number in range(2):
        play.until(play.now + 1)
        play.ask(ask_read(), number)
        play.hear(CODEC.encode_reply(modbus.Registers(99, 3, (1, 1, 1, 1))), at=play.now + 0.03)
        play.answer(number)
    assert play.core.health(1, play.now).foreign_master


def test_a_second_answer_while_idle_is_counted_and_makes_suspect() -> None:
    play = book(Station())
    play.core.tracing = True
    play.ask(ask_read())
    answer = play.answer()
    play.hear(answer.received, at=play.now + 0.05)
    play.until(play.now + 0.1)
    assert play.core.counters.kinds["duplicate"] == 1
    assert play.core.stations[1].suspect
    assert [event.kind for event in play.traced] == [Kind.SENT, Kind.REPLY, Kind.DUPLICATE]
    play.until(play.now + 2)
    assert not play.core.stations[1].suspect, "its fence was answered"


def test_noise_is_counted_and_forgotten() -> None:
    play = book(Station())
    for number in range(50):
        play.hear(b"\xff\x00", at=number * 0.1)
    play.until(10)
    assert play.core.counters.kinds == {"unsolicited": 50}
    assert len(play.core.listener.buffer) == 0
    play.ask(ask_read())
    assert play.answer().error is None


def test_unasked_bytes_never_grow_beyond_their_bound() -> None:
    """I12."""
    play = Playbook(core(1))
    chance = random.Random(1)
    at = 0.0
    for _ in range(3000):
        at += C
        play.hear(chance.randbytes(8), at=at)
    play.until(at)
    assert len(play.core.listener.buffer) <= 512


def test_the_gap_counts_from_the_last_byte_heard_whoever_sent_it() -> None:
    """F08: foreign traffic ends, then 3.5 characters, then we."""
    play = book(Station())
    play.until(1.0)
    play.hear(b"\x55")
    play.until(1.0 + C)
    play.hear(b"\x55")
    play.ask(ask_read())
    play.answer()
    assert play.sent[0][0] == pytest.approx(1.0 + C + 3.5 * C)


def test_a_foreign_request_that_comes_while_we_wait_is_recognised() -> None:
    """G18 on a busy bus, where nobody is ever idle."""
    play = Playbook(core(1))
    foreign = CODEC.encode_request(modbus.ReadRegisters(9, 0x100, 2))
    for number in range(2):
        play.until(play.now + 2)
        play.ask(ask_read(), number)
        play.hear(foreign, at=play.now + 0.03)
        play.answer(number)
    assert play.core.health(1, play.now).foreign_master


@pytest.mark.parametrize("waiting", [True, False])
def test_f01_a_late_mirrored_answer_is_late_and_no_foreign_master(waiting: bool) -> None:
    """The answer of FC06 is a valid request: from a station that owes us one it is its answer, whenever it comes."""
    play = Playbook(core(1))
    late = CODEC.encode_reply(modbus.Written(1, 6, 0x2001, 1000))
    play.ask(ask_read())
    for _ in range(3):
        play.core.stations[1].suspect = True
        if waiting:
            play.until(play.now + 1)
            play.hear(late, at=play.now + 0.001)
        else:
            play.hear(late, at=play.now + 1)
        play.until(play.now + 1)
    assert not play.core.health(1, play.now).foreign_master
    assert play.core.counters.kinds["late"] >= 2
    assert "master" not in play.core.counters.kinds


@pytest.mark.parametrize("model", ["c320", "dzb100", "vc660", "df800"])
@pytest.mark.parametrize("address", [1, 2])
@pytest.mark.parametrize("waiting", [True, False])
def test_f14_a_foreign_master_is_heard_in_every_family_also_while_a_station_owes_an_answer(
    model: str, address: int, waiting: bool
) -> None:
    """I8: its request may be for the very station that is silent; no bytes whatever may end the bus."""
    ours, stranger = (make_dialect(profiles.load(model), one) for one in (1, address))
    bus = BusCore(LINE, echo="off")
    bus.add(ours.link)
    play = Playbook(bus)
    play.ask(Ask(1, ours.plain_read()), "silent")
    play.answer("silent")
    assert bus.stations[1].suspect
    foreign = stranger.codec.encode_request(stranger.plain_read())
    for _ in range(2):
        if waiting:
            play.ask(Ask(1, ours.stop(Stop.STOP)[0]), "stop")
            play.until(play.now + 0.05)
        play.hear(foreign)
        play.until(play.now + 2.0)
    assert bus.health(1, play.now).foreign_master
