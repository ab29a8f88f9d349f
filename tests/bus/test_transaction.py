"""One request and all that can come of it: deadlines, silence, foreign frames, damage (F01-F05)."""

from __future__ import annotations

from typing import Any

import pytest

from buskit import CODEC, LINE, LINES, TIMING, C, Station, ask_read, book, byte_by_byte, core, wire
from drivebus.bus.echo import EchoFilter
from drivebus.bus.job import Job
from drivebus.bus.transaction import Transaction
from drivebus.errors import ChecksumError, LineFault, NoReply, TrailingError
from drivebus.message import Ask
from drivebus.protocols import modbus
from drivebus.testing.playbook import Playbook

SENT_END = 8 * C
REPLY_BYTES = 13
GAP = 3.5 * C


@pytest.mark.parametrize("line", LINES)
def test_a_read_is_answered_by_its_own_station_on_every_line(line: str) -> None:
    """I5 on the four lines: whatever the line does, the values are those of that very request, or there are none."""
    station = Station()
    play = book(station, deliver=LINES[line]())
    for number in range(200):
        play.ask(ask_read(), number)
        answer = play.answer(number)
        if answer.error is None:
            assert answer.reply.values == (station.answers,) * 4
    assert play.core.statistics(play.now).replies > 150


def test_a_clean_read_takes_exactly_what_the_arithmetic_says() -> None:
    play = book(Station(delay_s=0.005))
    play.until(1.0)
    play.ask(ask_read())
    answer = play.answer()
    assert answer.sent_at == 1.0
    assert answer.received_at == pytest.approx(1.0 + SENT_END + 0.005 + REPLY_BYTES * C)
    assert play.now == pytest.approx(answer.received_at + GAP)
    assert answer.attempts == 1 and answer.sent == CODEC.encode_request(ask_read().request)


def test_whole_and_byte_by_byte_give_the_same_answer_at_the_same_time() -> None:
    """F04: the end of a frame is its length; how it was cut on the way does not matter."""
    both = []
    for deliver in (LINES["clean"](), byte_by_byte):
        play = book(Station(), deliver=deliver)
        play.ask(ask_read())
        both.append((play.answer().reply, play.now))
    assert both[0][0] == both[1][0] and both[0][1] == pytest.approx(both[1][1])


def test_silence_ends_at_the_computed_deadline() -> None:
    play = book(Station(alive=False))
    play.until(1.0)
    play.ask(ask_read())
    answer = play.answer()
    assert isinstance(answer.error, NoReply) and answer.error.params["milliseconds"] == round(
        TIMING.timeout_s(LINE, REPLY_BYTES) * 1000
    )
    assert play.now == pytest.approx(1.0 + SENT_END + TIMING.timeout_s(LINE, REPLY_BYTES))


def test_bytes_never_extend_the_deadline() -> None:
    """F05: a station that dribbles is given up at the same moment as one that says nothing."""
    play = Playbook(core(1))
    play.until(1.0)
    play.ask(ask_read())
    reply = CODEC.encode_reply(modbus.Registers(1, 3, (1, 2, 3, 4)))
    for place in range(10):
        play.hear(reply[place : place + 1], at=1.01 + place * 0.005)
    answer = play.answer()
    assert isinstance(answer.error, NoReply) and answer.error.params["bytes"] == 10
    assert play.now == pytest.approx(1.0 + SENT_END + TIMING.timeout_s(LINE, REPLY_BYTES))


def test_another_stations_frame_is_dropped_and_waiting_goes_on() -> None:
    """F02: discard, count, keep waiting to the original deadline."""
    play = Playbook(core(1, 2))
    play.until(1.0)
    play.ask(ask_read())
    play.hear(CODEC.encode_reply(modbus.Registers(2, 3, (9, 9, 9, 9))), at=1.0 + SENT_END + 13 * C)
    play.hear(CODEC.encode_reply(modbus.Registers(1, 3, (1, 2, 3, 4))), at=1.0 + SENT_END + 30 * C)
    answer = play.answer()
    assert answer.reply.values == (1, 2, 3, 4)
    assert play.core.counters.kinds["foreign"] == 1


def test_a_reply_is_believed_only_after_the_gap_in_silence() -> None:
    play = Playbook(core(1))
    play.until(1.0)
    play.ask(ask_read())
    heard = 1.0 + SENT_END + 20 * C
    play.hear(CODEC.encode_reply(modbus.Registers(1, 3, (1, 2, 3, 4))), at=heard)
    play.until(heard + GAP * 0.99)
    assert not play.answers
    play.until(heard + GAP * 1.01)
    assert play.answer().reply.values == (1, 2, 3, 4)


def test_a_byte_after_the_reply_voids_it() -> None:
    play = Playbook(core(1))
    play.until(1.0)
    play.core.stations[1].seen = True
    play.ask(ask_read())
    heard = 1.0 + SENT_END + 20 * C
    play.hear(CODEC.encode_reply(modbus.Registers(1, 3, (1, 2, 3, 4))), at=heard)
    play.hear(b"\x00", at=heard + GAP * 0.5)
    play.until(heard + 3 * GAP)
    assert not play.answers, "a second answer may be on its way: quarantine and fence come first"
    assert play.core.stations[1].suspect
    assert play.core.counters.errors == {TrailingError.__name__: 1}


def test_damage_is_repeated_at_once_and_only_once() -> None:
    """V, R of the fault matrix: the answer has come and is spoiled, so nothing can come late."""
    play = Playbook(core(1), lambda frame, ended: [(ended + 20 * C, b"\x01\x03\x08" + bytes(10))])
    play.ask(ask_read())
    play.core.stations[1].seen = True
    answer = play.answer()
    assert isinstance(answer.error, ChecksumError) and answer.attempts == 2
    assert not play.core.stations[1].suspect
    assert play.core.counters.kinds["retry"] == 1


def test_marked_bytes_void_the_transaction_whatever_they_say() -> None:
    """G20: a parity or framing error spoils the frame even where its check sum fits."""
    play = Playbook(core(1))
    play.until(1.0)
    play.ask(ask_read())
    play.hear(CODEC.encode_reply(modbus.Registers(1, 3, (1, 2, 3, 4))), at=1.05, marks=1)
    answer = play.answer()
    assert isinstance(answer.error, LineFault) and answer.error.key == "bus.marks"
    assert answer.reply is None


def test_what_comes_before_our_own_last_stop_bit_is_no_answer() -> None:
    """F03, on a port whose pacing is real."""
    play = Playbook(core(1))
    play.until(1.0)
    play.ask(ask_read())
    play.hear(CODEC.encode_reply(modbus.Registers(1, 3, (1, 2, 3, 4))), at=1.0 + SENT_END * 0.9)
    answer = play.answer()
    assert isinstance(answer.error, NoReply)
    assert play.core.counters.kinds["early"] == REPLY_BYTES


def test_an_unpaced_port_can_not_tell_early_from_late() -> None:
    """Ruling 9: ptys and TCP have no pacing, so the rule does not apply there."""
    play = Playbook(core(1, paced=False))
    play.until(1.0)
    play.ask(ask_read())
    play.hear(CODEC.encode_reply(modbus.Registers(1, 3, (1, 2, 3, 4))), at=1.0 + SENT_END * 0.9)
    assert play.answer().reply.values == (1, 2, 3, 4)


def test_garbage_before_the_reply_fails_this_transaction_only() -> None:
    """F05: no hunting. The next transaction is not touched."""
    station = Station()
    clean = wire(station)
    noisy = [True]

    def once(frame: bytes, ended: float):  # type: ignore[no-untyped-def]
        if noisy.pop() if noisy else False:
            yield ended + C, b"\xff"
        yield from clean(frame, ended)

    play = Playbook(core(1), once)
    play.ask(ask_read(), "first")
    assert play.answer("first").reply is None
    play.ask(ask_read(), "second")
    assert play.answer("second").reply is not None


def test_a_short_error_is_believed_only_if_nothing_follows() -> None:
    """T15, ruling 11: five bytes are an error of DF800, or the beginning of its eight-byte echo."""
    codec = modbus.RtuCodec(error_form="short")
    from buskit import ask_write, link

    for rest in (b"", b"\x00"):
        bus = core(2)
        bus.add(link(1, codec=codec))
        play = Playbook(bus)
        bus.stations[1].seen = True
        bus.echo.proved = True
        request = ask_write(bus, register=0x0000, value=0x0000)
        short = codec.encode_reply(modbus.ErrorReply(1, 6, None))
        play.ask(request)
        play.hear(short, at=0.05)
        if rest:
            play.hear(rest, at=0.0505)
            play.until(0.5)
            assert play.core.statistics(play.now).replies == 0
        else:
            assert isinstance(play.answer().reply, modbus.ErrorReply)


@pytest.mark.parametrize(("stall_s", "believed"), [(0.1, True), (0.3, False)])
def test_a_host_that_looked_late_believes_only_what_is_not_much_too_late(stall_s: float, believed: bool) -> None:
    """The reply is read after the deadline, before the wake of the deadline was served: it may have come in time."""
    bus = core(1)
    play = Playbook(bus)
    play.until(1.0)
    play.ask(ask_read())
    deadline = bus.flight.final_at  # type: ignore[union-attr]
    play._wake = None
    play.hear(CODEC.encode_reply(modbus.Registers(1, 3, (1, 2, 3, 4))), at=deadline + stall_s)
    answer = play.answer()
    assert (answer.error is None) is believed


def flight(**options: Any) -> Transaction:
    job = Job(ask_read(), None, core(1).stations[1], LINE)
    return Transaction(job, 1.0, C, paced=True, echo=None, **options)


def test_the_reader_may_sleep_until_a_byte_could_complete_the_reply() -> None:
    """Before that moment no byte can end the frame on a line of this speed; afterwards every byte is wanted."""
    reply = CODEC.encode_reply(modbus.Registers(1, 3, (1, 2, 3, 4)))
    one = flight()
    assert one.useful_at() == pytest.approx(1.0 + SENT_END + (REPLY_BYTES - 1) * C)
    one.received(reply[:4], 1.1)
    assert one.need == 5 and one.useful_at() == pytest.approx(1.1 + 0 * C)
    one.received(reply[4:5], 1.2)
    assert one.need == REPLY_BYTES and one.useful_at() == pytest.approx(1.2 + 7 * C)
    one.received(reply[5:], 1.3)
    assert one.message is not None and one.useful_at() is None


def test_the_reader_stays_awake_where_something_else_than_a_reply_may_come() -> None:
    damaged = flight()
    damaged.received(b"\x01\x07\x00\x00\x00", 1.1)
    assert damaged.error is not None and damaged.useful_at() is None
    assert Transaction(flight().job, 1.0, C, paced=True, echo=EchoFilter(b"frame", True)).useful_at() is None
    stop = Job(Ask(0, modbus.WriteRegister(0, 0x2000, 2)), None, core(1).stations[1], LINE)
    assert Transaction(stop, 1.0, C, paced=True, echo=None).useful_at() is None


def test_a_byte_behind_the_reply_is_told_with_both_lengths() -> None:
    reply = CODEC.encode_reply(modbus.Registers(1, 3, (1, 2, 3, 4)))
    one = flight()
    one.received(reply + b"\x00", 1.1)
    assert isinstance(one.error, TrailingError) and one.error.key == "bus.trailing"
    assert one.error.params == {"expected": REPLY_BYTES, "found": REPLY_BYTES + 1}


def test_g20_a_mark_without_a_byte_voids_the_reply_that_was_whole() -> None:
    """It ends at the deadline: what else is on its way is not sent into."""
    one = flight()
    one.received(CODEC.encode_reply(modbus.Registers(1, 3, (1, 2, 3, 4))), 1.05)
    assert one.final_at < one.deadline
    one.received(b"", 1.051, marks=1)
    assert isinstance(one.error, LineFault) and one.final_at == one.deadline


def test_how_long_was_waited_is_told_in_milliseconds() -> None:
    one = flight()
    one.deadline = one.sent_end + 2.0
    error = one.outcome()
    assert isinstance(error, NoReply) and error.params["milliseconds"] == 2000
