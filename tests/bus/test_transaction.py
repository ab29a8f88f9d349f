"""Transactions and their possible results: deadlines, silence, foreign frames, damage."""

from __future__ import annotations

from typing import Any

import pytest

from drivebus.bus.echo import EchoFilter
from drivebus.bus.messages import BusRequest
from drivebus.bus.prepared_request import PreparedRequest
from drivebus.bus.station import StationState
from drivebus.bus.transaction import Transaction
from drivebus.errors import ChecksumError, LineError, NoReply, TrailingError
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
    read_request,
    wire_to,
)

SENT_END = 8 * CHARACTER_S
REPLY_BYTES = 13
GAP = 3.5 * CHARACTER_S


@pytest.mark.parametrize("line", DELIVERIES)
def test_a_read_gets_the_reply_of_its_own_station_in_every_family(line: str) -> None:
    """At every line quality the values are those of the request, or there are none."""
    station = FakeStation()
    script = make_script(station, deliver=DELIVERIES[line]())
    for number in range(200):
        script.submit(read_request(), number)
        result = script.result(number)
        if result.error is None:
            assert result.reply.values == (station.read_count,) * 4
    assert script.core.statistics(script.now).replies > 150


def test_a_clean_read_takes_exactly_the_computed_time() -> None:
    script = make_script(FakeStation(delay_s=0.005))
    script.run_until(1.0)
    script.submit(read_request())
    result = script.result()
    assert result.sent_at == 1.0
    assert result.received_at == pytest.approx(1.0 + SENT_END + 0.005 + REPLY_BYTES * CHARACTER_S)
    assert script.now == pytest.approx(result.received_at + GAP)
    assert result.attempts == 1 and result.sent == CODEC.encode_request(read_request().request)


def test_whole_and_byte_by_byte_give_the_same_reply_at_the_same_time() -> None:
    """A frame ends by its length, however it was split on the way."""
    both = []
    for deliver in (DELIVERIES["clean"](), byte_by_byte):
        script = make_script(FakeStation(), deliver=deliver)
        script.submit(read_request())
        both.append((script.result().reply, script.now))
    assert both[0][0] == both[1][0] and both[0][1] == pytest.approx(both[1][1])


def test_silence_ends_at_the_computed_deadline() -> None:
    script = make_script(FakeStation(alive=False))
    script.run_until(1.0)
    script.submit(read_request())
    result = script.result()
    assert isinstance(result.error, NoReply) and result.error.params["milliseconds"] == round(
        TIMING.timeout_s(SETTINGS, REPLY_BYTES) * 1000
    )
    assert script.now == pytest.approx(1.0 + SENT_END + TIMING.timeout_s(SETTINGS, REPLY_BYTES))


def test_bytes_never_extend_the_deadline() -> None:
    """A station that sends byte by byte times out at the same moment as a silent one."""
    script = BusScript(make_core(1))
    script.run_until(1.0)
    script.submit(read_request())
    reply = CODEC.encode_reply(modbus.RegisterValues(1, 3, (1, 2, 3, 4)))
    for place in range(10):
        script.receive(reply[place : place + 1], at=1.01 + place * 0.005)
    result = script.result()
    assert isinstance(result.error, NoReply) and result.error.params["bytes"] == 10
    assert script.now == pytest.approx(1.0 + SENT_END + TIMING.timeout_s(SETTINGS, REPLY_BYTES))


def test_another_stations_frame_is_dropped_and_waiting_goes_on() -> None:
    """Discard, count, keep waiting to the original deadline."""
    script = BusScript(make_core(1, 2))
    script.run_until(1.0)
    script.submit(read_request())
    script.receive(CODEC.encode_reply(modbus.RegisterValues(2, 3, (9, 9, 9, 9))), at=1.0 + SENT_END + 13 * CHARACTER_S)
    script.receive(CODEC.encode_reply(modbus.RegisterValues(1, 3, (1, 2, 3, 4))), at=1.0 + SENT_END + 30 * CHARACTER_S)
    result = script.result()
    assert result.reply.values == (1, 2, 3, 4)
    assert script.core.counters.events["foreign"] == 1


def test_a_reply_is_accepted_only_after_the_gap_in_silence() -> None:
    script = BusScript(make_core(1))
    script.run_until(1.0)
    script.submit(read_request())
    received = 1.0 + SENT_END + 20 * CHARACTER_S
    script.receive(CODEC.encode_reply(modbus.RegisterValues(1, 3, (1, 2, 3, 4))), at=received)
    script.run_until(received + GAP * 0.99)
    assert not script.results
    script.run_until(received + GAP * 1.01)
    assert script.result().reply.values == (1, 2, 3, 4)


def test_a_byte_after_the_reply_invalidates_it() -> None:
    script = BusScript(make_core(1))
    script.run_until(1.0)
    script.core.stations[1].state = StationState.ONLINE
    script.submit(read_request())
    received = 1.0 + SENT_END + 20 * CHARACTER_S
    script.receive(CODEC.encode_reply(modbus.RegisterValues(1, 3, (1, 2, 3, 4))), at=received)
    script.receive(b"\x00", at=received + GAP * 0.5)
    script.run_until(received + 3 * GAP)
    assert not script.results, "a second answer may be on its way: quarantine and sync probe come first"
    assert script.core.stations[1].state.is_suspect
    assert script.core.counters.errors == {TrailingError.__name__: 1}


def test_a_damaged_reply_is_retried_at_once_and_only_once() -> None:
    """The reply has come and is damaged, so nothing can come late."""
    script = BusScript(make_core(1), lambda frame, ended: [(ended + 20 * CHARACTER_S, b"\x01\x03\x08" + bytes(10))])
    script.submit(read_request())
    script.core.stations[1].state = StationState.ONLINE
    result = script.result()
    assert isinstance(result.error, ChecksumError) and result.attempts == 2
    assert not script.core.stations[1].state.is_suspect
    assert script.core.counters.events["retry"] == 1


def test_line_errors_invalidate_the_transaction_whatever_the_bytes() -> None:
    """A parity or framing error damages the frame even where its checksum fits."""
    script = BusScript(make_core(1))
    script.run_until(1.0)
    script.submit(read_request())
    script.receive(CODEC.encode_reply(modbus.RegisterValues(1, 3, (1, 2, 3, 4))), at=1.05, line_errors=1)
    result = script.result()
    assert isinstance(result.error, LineError) and result.error.key == "bus.line_errors"
    assert result.reply is None


def test_bytes_before_the_last_stop_bit_of_the_request_are_no_reply() -> None:
    """The port has line timing."""
    script = BusScript(make_core(1))
    script.run_until(1.0)
    script.submit(read_request())
    script.receive(CODEC.encode_reply(modbus.RegisterValues(1, 3, (1, 2, 3, 4))), at=1.0 + SENT_END * 0.9)
    result = script.result()
    assert isinstance(result.error, NoReply)
    assert script.core.counters.events["before_tx_end"] == REPLY_BYTES


def test_a_port_without_line_timing_cannot_detect_early_bytes() -> None:
    """Ptys and TCP have no line timing, so the rule does not apply there."""
    script = BusScript(make_core(1, has_line_timing=False))
    script.run_until(1.0)
    script.submit(read_request())
    script.receive(CODEC.encode_reply(modbus.RegisterValues(1, 3, (1, 2, 3, 4))), at=1.0 + SENT_END * 0.9)
    assert script.result().reply.values == (1, 2, 3, 4)


def test_garbage_before_the_reply_fails_this_transaction_only() -> None:
    """No frame is searched in other bytes. The next transaction is not affected."""
    station = FakeStation()
    clean = wire_to(station)
    noisy = [True]

    def once(frame: bytes, ended: float):  # type: ignore[no-untyped-def]
        if noisy.pop() if noisy else False:
            yield ended + CHARACTER_S, b"\xff"
        yield from clean(frame, ended)

    script = BusScript(make_core(1), once)
    script.submit(read_request(), "first")
    assert script.result("first").reply is None
    script.submit(read_request(), "second")
    assert script.result("second").reply is not None


def test_a_short_error_is_accepted_only_if_nothing_follows() -> None:
    """Five bytes are an error of DF800, or the beginning of its eight-byte echo."""
    codec = modbus.ModbusRtuCodec(error_form="short")
    from fixtures.bus import station_config, write_request

    for rest in (b"", b"\x00"):
        bus = make_core(2)
        bus.registry.add(station_config(1, codec=codec))
        script = BusScript(bus)
        bus.stations[1].state = StationState.ONLINE
        bus.echo.ruled_out = True
        request = write_request(bus, register=0x0000, value=0x0000)
        short = codec.encode_reply(modbus.ExceptionReply(1, 6, None))
        script.submit(request)
        script.receive(short, at=0.05)
        if rest:
            script.receive(rest, at=0.0505)
            script.run_until(0.5)
            assert script.core.statistics(script.now).replies == 0
        else:
            assert isinstance(script.result().reply, modbus.ExceptionReply)


@pytest.mark.parametrize(("stall_s", "accepted"), [(0.19, True), (0.21, False)])
def test_a_master_that_reads_late_accepts_only_replies_within_the_stall_tolerance(
    stall_s: float, accepted: bool
) -> None:
    """The reply is read after the deadline but before its timer is served, so it may have come in time."""
    bus = make_core(1)
    script = BusScript(bus)
    script.run_until(1.0)
    script.submit(read_request())
    deadline = bus.transaction.ends_at  # type: ignore[union-attr]
    bus.wake_at = None
    script.receive(CODEC.encode_reply(modbus.RegisterValues(1, 3, (1, 2, 3, 4))), at=deadline + stall_s)
    result = script.result()
    assert (result.error is None) is accepted


def test_a_byte_that_a_busy_master_reads_long_after_a_complete_reply_may_still_belong_to_it() -> None:
    """The silence after the reply was not watched, so whether the byte came in it is not known."""
    bus = make_core(1)
    script = BusScript(bus)
    script.run_until(1.0)
    script.submit(read_request())
    script.receive(CODEC.encode_reply(modbus.RegisterValues(1, 3, (1, 2, 3, 4))), at=1.05)
    script.run_until(1.05)
    bus.wake_at = None
    script.receive(b"\x01", at=2.0)
    assert isinstance(script.result().error, TrailingError)


def make_transaction(**options: Any) -> Transaction:
    prepared = PreparedRequest(read_request(), None, make_core(1).stations[1], SETTINGS)
    return Transaction(prepared, 1.0, CHARACTER_S, has_line_timing=True, echo=None, **options)


def test_the_reader_is_paused_until_a_byte_could_complete_the_reply() -> None:
    """Before that moment no byte can end the frame on a bus of this speed; afterwards every byte is wanted."""
    reply = CODEC.encode_reply(modbus.RegisterValues(1, 3, (1, 2, 3, 4)))
    transaction = make_transaction()
    assert transaction.earliest_useful_at() == pytest.approx(1.0 + SENT_END + (REPLY_BYTES - 1) * CHARACTER_S)
    transaction.on_data(reply[:4], 1.1)
    assert transaction.bytes_needed == 5 and transaction.earliest_useful_at() == pytest.approx(1.1 + 0 * CHARACTER_S)
    transaction.on_data(reply[4:5], 1.2)
    assert transaction.bytes_needed == REPLY_BYTES and transaction.earliest_useful_at() == pytest.approx(
        1.2 + 7 * CHARACTER_S
    )
    transaction.on_data(reply[5:], 1.3)
    assert transaction.message is not None and transaction.earliest_useful_at() is None


def test_the_reader_is_not_paused_where_other_bytes_than_a_reply_may_arrive() -> None:
    damaged = make_transaction()
    damaged.on_data(b"\x01\x07\x00\x00\x00", 1.1)
    assert damaged.error is not None and damaged.earliest_useful_at() is None
    assert (
        Transaction(
            make_transaction().prepared,
            1.0,
            CHARACTER_S,
            has_line_timing=True,
            echo=EchoFilter(b"frame", tentative=True),
        ).earliest_useful_at()
        is None
    )
    stop = PreparedRequest(
        BusRequest(station=0, request=modbus.WriteRegister(0, 0x2000, 2)), None, make_core(1).stations[1], SETTINGS
    )
    assert Transaction(stop, 1.0, CHARACTER_S, has_line_timing=True, echo=None).earliest_useful_at() is None


def test_a_byte_behind_the_reply_is_reported_with_both_lengths() -> None:
    reply = CODEC.encode_reply(modbus.RegisterValues(1, 3, (1, 2, 3, 4)))
    transaction = make_transaction()
    transaction.on_data(reply + b"\x00", 1.1)
    assert isinstance(transaction.error, TrailingError) and transaction.error.key == "bus.trailing"
    assert transaction.error.params == {"station": 1, "expected": REPLY_BYTES, "found": REPLY_BYTES + 1}


def test_a_line_error_without_a_byte_invalidates_a_complete_reply() -> None:
    """The transaction ends at its deadline, so that no frame collides with further bytes."""
    transaction = make_transaction()
    transaction.on_data(CODEC.encode_reply(modbus.RegisterValues(1, 3, (1, 2, 3, 4))), 1.05)
    assert transaction.ends_at < transaction.deadline
    transaction.on_data(b"", 1.051, line_errors=1)
    assert isinstance(transaction.error, LineError) and transaction.ends_at == transaction.deadline


def test_the_timeout_is_reported_in_milliseconds() -> None:
    transaction = make_transaction()
    transaction.deadline = transaction.tx_end_at + 2.0
    error = transaction.final_error()
    assert isinstance(error, NoReply) and error.params["milliseconds"] == 2000
