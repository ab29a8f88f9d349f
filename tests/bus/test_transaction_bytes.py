"""End and error of a single transaction, byte by byte."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from drivebus.bus.echo import EchoFilter
from drivebus.bus.messages import BusRequest
from drivebus.bus.prepared_request import PreparedRequest
from drivebus.bus.station import Station
from drivebus.bus.transaction import Transaction
from drivebus.errors import (
    AddressError,
    AlphabetError,
    ChecksumError,
    DrivebusError,
    EchoError,
    LineError,
    NoReply,
    TrailingError,
)
from drivebus.protocols import modbus
from drivebus.protocols.codec import Complete, CompleteIfSilent, DecodeResult
from fixtures.bus import CHARACTER_S, COMMAND, SETTINGS, STOP, TIMING, read_request, station_config

RTU = modbus.ModbusRtuCodec()
REPLY = RTU.encode_reply(modbus.RegisterValues(1, 3, (1, 2, 3, 4)))
OTHERS = RTU.encode_reply(modbus.RegisterValues(2, 3, (9,)))
DAMAGED = REPLY[:-1] + bytes((REPLY[-1] ^ 1,))
END = 1.0 + 8 * CHARACTER_S
"""Our last bit."""
DEADLINE = END + TIMING.timeout_s(SETTINGS, 13)
GAP = TIMING.gap_s(SETTINGS)


def make_transaction(
    request: Any = None, codec: Any = RTU, paced: bool = True, echo: Any = None, **timing: Any
) -> Transaction:
    station = Station(station_config(1, replace(TIMING, **timing), codec), SETTINGS)
    prepared = PreparedRequest(
        read_request() if request is None else BusRequest(station=1, request=request), None, station, SETTINGS
    )
    prepared.attempts = 1
    return Transaction(prepared, 1.0, CHARACTER_S, has_line_timing=paced, echo=echo)


def test_a_transaction_begins_with_the_computed_times_and_ends_at_its_deadline() -> None:
    transaction = make_transaction()
    assert (transaction.sent_at, transaction.tx_end_at, transaction.deadline, transaction.ends_at) == (
        1.0,
        END,
        DEADLINE,
        DEADLINE,
    )
    error = transaction.final_error()
    assert isinstance(error, NoReply) and error.key == "bus.no_reply"
    wait_ms = round((DEADLINE - END) * 1000)
    assert error.params == {"station": 1, "attempt": 1, "bytes": 0, "milliseconds": wait_ms}


@pytest.mark.parametrize(("age_s", "named"), [(0.25, True), (1.0, True), (1.1, False)])
def test_silence_after_a_recent_reply_tells_the_age_of_that_reply(age_s: float, named: bool) -> None:
    """Address and serial settings of such a station are right, and need no check."""
    transaction = make_transaction()
    transaction.prepared.station.last_reply_at = transaction.sent_at - age_s
    error = transaction.final_error()
    assert isinstance(error, NoReply) and error.key == ("bus.no_reply_to_next" if named else "bus.no_reply")
    assert error.params.get("since_ms") == (round(age_s * 1000) if named else None)


def test_a_complete_reply_is_accepted_after_the_gap() -> None:
    transaction = make_transaction()
    transaction.on_data(REPLY, 1.05)
    assert transaction.ends_at == 1.05 + GAP and transaction.final_error() is None
    assert transaction.message == modbus.RegisterValues(1, 3, (1, 2, 3, 4)) and (
        transaction.received_count,
        transaction.message_size,
        transaction.last_byte_at,
    ) == (13, 13, 1.05)


def test_a_part_of_a_reply_is_reported_truncated_at_the_deadline() -> None:
    transaction = make_transaction()
    for place in range(12):
        transaction.on_data(REPLY[place : place + 1], 1.05 + place * CHARACTER_S)
        assert transaction.ends_at == DEADLINE
    error = transaction.final_error()
    assert isinstance(error, NoReply) and (error.key, error.params["bytes"]) == ("bus.truncated", 12)
    transaction.on_data(REPLY[12:], 1.08)
    assert transaction.final_error() is None and transaction.ends_at == 1.08 + GAP


@pytest.mark.parametrize("pieces", [[14], [13, 1]])
def test_a_further_byte_invalidates_the_reply_whenever_it_comes(pieces: list[int]) -> None:
    transaction, data = make_transaction(), REPLY + b"\x00"
    for size in pieces:
        transaction.on_data(data[:size], 1.05)
        data = data[size:]
    error = transaction.final_error()
    assert isinstance(error, TrailingError) and (error.expected, error.found) == (13, 14)
    assert transaction.message is None and transaction.ends_at == 1.05 + GAP


def test_an_invalid_reply_ends_after_its_bytes_and_the_gap_but_never_after_the_deadline() -> None:
    transaction = make_transaction()
    transaction.on_data(DAMAGED[:12], 1.04)
    assert transaction.ends_at == DEADLINE
    transaction.on_data(DAMAGED[12:], 1.05)
    assert isinstance(transaction.final_error(), ChecksumError) and transaction.ends_at == 1.05 + GAP
    transaction.on_data(b"\x00", DEADLINE - GAP / 2)
    assert transaction.ends_at == DEADLINE
    assert isinstance(transaction.final_error(), ChecksumError), "the first error is reported"


def test_the_first_error_is_reported() -> None:
    transaction = make_transaction()
    transaction.on_data(REPLY, 1.05)
    transaction.on_data(b"\x00", 1.051, line_errors=1)
    assert isinstance(transaction.final_error(), LineError)
    transaction.on_data(b"", 1.052, line_errors=5)
    error = transaction.final_error()
    assert isinstance(error, LineError) and (error.key, error.params) == ("bus.line_errors", {"station": 1, "count": 1})


def test_line_errors_alone_invalidate_it_until_the_deadline() -> None:
    transaction = make_transaction()
    transaction.on_data(b"", 1.05, line_errors=2)
    error = transaction.final_error()
    assert isinstance(error, LineError) and error.params["count"] == 2
    assert transaction.ends_at == DEADLINE and transaction.received_count == 0 and transaction.last_byte_at is None


def test_foreign_frames_are_dropped_and_recorded_and_the_reply_after_them_is_accepted() -> None:
    transaction = make_transaction()
    transaction.on_data(OTHERS + OTHERS + REPLY[:5], 1.05)
    assert [data for data, _ in transaction.foreign_frames or ()] == [OTHERS, OTHERS]
    assert all(isinstance(error, AddressError) for _, error in transaction.foreign_frames or ())
    assert (transaction.received_count, transaction.buffer, transaction.bytes_needed) == (5, REPLY[:5], 13)
    transaction.on_data(REPLY[5:], 1.06)
    assert transaction.final_error() is None and transaction.message == modbus.RegisterValues(1, 3, (1, 2, 3, 4))


def test_after_a_foreign_frame_alone_the_transaction_still_waits() -> None:
    transaction = make_transaction()
    transaction.on_data(OTHERS, 1.05)
    assert (transaction.received_count, transaction.buffer, transaction.bytes_needed, transaction.error) == (
        0,
        b"",
        1,
        None,
    )
    error = transaction.final_error()
    assert isinstance(error, NoReply) and error.key == "bus.no_reply"
    transaction.on_data(REPLY, 1.06)
    assert transaction.final_error() is None


class WrongSizeCodec(modbus.ModbusRtuCodec):
    """Codec that raises an AddressError with an impossible size."""

    size = 0

    def decode_reply(self, request: Any, data: bytes, /) -> DecodeResult:
        raise AddressError("modbus.address", expected=1, found=2, size=self.size)


@pytest.mark.parametrize(("size", "dropped"), [(-1, False), (0, False), (1, True), (5, True), (6, False)])
def test_a_foreign_frame_is_dropped_only_when_complete(size: int, dropped: bool) -> None:
    codec = WrongSizeCodec()
    codec.size = size
    transaction = make_transaction(codec=codec)
    transaction.on_data(b"\x02\x03\x04\x05\x06", 1.05)
    assert (transaction.error is None) is dropped
    assert len(transaction.foreign_frames or ()) == ((5 // size) if dropped else 0)


@pytest.mark.parametrize(
    ("size", "characters", "remaining"),
    [
        (1, 0.4, 0),
        (1, 0.6, 1),
        (3, 0.4, 0),
        (3, 1.4, 1),
        (3, 1.6, 2),
        (3, 2.4, 2),
        (3, 2.6, 3),
        (3, -9.0, 0),
        (13, 9.0, 9),
    ],
)
def test_bytes_that_end_before_the_last_bit_of_the_request_are_no_reply(
    size: int, characters: float, remaining: int
) -> None:
    """The last of them came at ``characters`` after our last bit, each earlier one a character before it."""
    for paced in (True, False):
        transaction = make_transaction(paced=paced)
        transaction.on_data(REPLY[:size], END + characters * CHARACTER_S)
        expected = remaining if paced else size
        assert (len(transaction.bytes_before_tx_end), transaction.received_count) == (size - expected, expected)
        assert transaction.buffer == REPLY[size - expected : size]
        assert (transaction.last_byte_at is not None) is (expected > 0)


def test_a_broadcast_is_over_after_its_turnaround_whatever_is_received() -> None:
    transaction = make_transaction(modbus.WriteRegister(0, COMMAND, STOP))
    assert transaction.ends_at == END + TIMING.turnaround_s
    transaction.on_data(REPLY, 1.05)
    assert transaction.ends_at == END + TIMING.turnaround_s and transaction.final_error() is None
    assert (transaction.received_count, transaction.buffer) == (13, b"")
    transaction.on_data(b"\x00", 1.06, line_errors=1)
    assert isinstance(transaction.final_error(), LineError)


def test_a_stray_byte_is_skipped_once_where_the_profile_allows_it() -> None:
    transaction = make_transaction(tolerate_leading_noise=True)
    transaction.on_data(b"\xff" + REPLY, 1.05)
    assert transaction.final_error() is None and (
        transaction.bytes_before_tx_end,
        transaction.received_count,
        transaction.noise_skipped,
    ) == (
        b"\xff",
        13,
        True,
    )
    two = make_transaction(tolerate_leading_noise=True)
    two.on_data(b"\xff\xff" + REPLY, 1.05)
    assert two.final_error() is not None and two.received_count == 14
    none = make_transaction()
    none.on_data(b"\xff" + REPLY, 1.05)
    assert none.final_error() is not None and not none.noise_skipped


def test_after_the_stray_byte_the_reply_may_come_in_pieces() -> None:
    transaction = make_transaction(tolerate_leading_noise=True)
    for place, byte in enumerate(b"\xff" + REPLY):
        transaction.on_data(bytes((byte,)), 1.05 + place * CHARACTER_S)
    assert transaction.final_error() is None and transaction.bytes_before_tx_end == b"\xff"


def test_a_short_error_that_may_be_the_start_of_an_echo_waits_for_the_adapter_too() -> None:
    request = modbus.WriteRegister(1, 0x23, 0xA000)
    codec = modbus.ModbusRtuCodec("short")
    error = codec.encode_reply(modbus.ExceptionReply(1, 6, None))
    assert codec.encode_request(request).startswith(error)
    transaction = make_transaction(request, codec)
    transaction.on_data(error, 1.05)
    assert transaction.needs_silence and transaction.ends_at == 1.05 + (GAP + TIMING.adapter_latency_s)
    assert transaction.final_error() is None and transaction.message == modbus.ExceptionReply(1, 6, None)
    assert transaction.bytes_needed == 8
    transaction.on_data(codec.encode_request(request)[5:7], 1.051)
    assert transaction.ends_at == transaction.deadline and isinstance(transaction.final_error(), NoReply)
    transaction.on_data(codec.encode_request(request)[7:], 1.052)
    assert transaction.final_error() is None and transaction.message == modbus.WriteAck(1, 6, 0x23, 0xA000)
    assert transaction.ends_at == 1.052 + GAP and not transaction.needs_silence


def test_the_echo_is_removed_and_a_byte_that_differs_is_a_collision() -> None:
    request = read_request().request
    sent = RTU.encode_request(request)
    transaction = make_transaction(paced=False, echo=EchoFilter(sent, tentative=False))
    transaction.on_data(sent[:3], 1.001)
    assert (transaction.received_count, transaction.last_byte_at) == (0, None)
    transaction.on_data(sent[3:] + REPLY, 1.05)
    assert transaction.final_error() is None and transaction.received_count == 13
    other = make_transaction(paced=False, echo=EchoFilter(sent, tentative=False))
    other.on_data(sent[:3] + b"\xff", 1.05)
    error = other.final_error()
    assert isinstance(error, LineError)
    assert (error.key, error.params) == ("bus.collision", {"station": 1, "position": 4})


class RevisingCodec(modbus.ModbusRtuCodec):
    """Codec that takes the first byte for a whole reply, and two bytes for another one if silence follows."""

    def decode_reply(self, request: Any, data: bytes, /) -> DecodeResult:
        return Complete("first", 1) if len(data) == 1 else CompleteIfSilent("second", 2, 3)


def test_the_result_is_the_reply_that_was_decoded_last() -> None:
    """The result is made with the first complete reply; it would be out of date where more bytes change the reply."""
    transaction = make_transaction(codec=RevisingCodec())
    transaction.on_data(b"\x01", 1.05)
    assert transaction.result(None).reply == "first"
    transaction.on_data(b"\x02", 1.051)
    result = transaction.result(transaction.final_error())
    assert (result.reply, result.received, result.received_at) == ("second", b"\x01\x02", 1.051)


class CountingCodec(modbus.ModbusRtuCodec):
    """Codec that counts its calls."""

    times = 0

    def decode_reply(self, request: Any, data: bytes, /) -> DecodeResult:
        self.times += 1
        return super().decode_reply(request, data)


def test_the_codec_is_called_again_only_with_as_many_bytes_as_it_needs() -> None:
    codec = CountingCodec()
    transaction = make_transaction(codec=codec)
    for place in range(13):
        transaction.on_data(REPLY[place : place + 1], 1.05 + place * CHARACTER_S)
    assert transaction.final_error() is None and codec.times == 3, "with the first byte, the fifth, and the last"
    transaction.on_data(b"\x00\x00", 1.08)
    assert codec.times == 4
    transaction.on_data(b"\x00", 1.09)
    assert codec.times == 4, "an invalid reply stays invalid"


def test_a_reply_to_another_request_invalidates_it() -> None:
    transaction = make_transaction(modbus.WriteRegister(1, 7, 8))
    transaction.on_data(RTU.encode_reply(modbus.WriteAck(1, 6, 7, 9)), 1.05)
    assert isinstance(transaction.final_error(), EchoError) and transaction.message is None
    assert transaction.ends_at == 1.05 + GAP


WRITE = modbus.WriteRegister(1, 7, 8)
WRITE_FRAME = RTU.encode_request(WRITE)


def test_bytes_that_equal_the_frame_after_a_collision_are_no_echo() -> None:
    """The frame is lost already: what follows counts as received, as any byte of a line in use does."""
    echo = EchoFilter(b"abcd", tentative=False)
    assert echo.strip(b"aX") == b"aX" and echo.collided
    assert echo.strip(b"bcd") == b"bcd" and not echo.is_complete


def test_bytes_taken_for_an_echo_that_was_none_are_counted_once() -> None:
    transaction = make_transaction(
        paced=False, echo=EchoFilter(RTU.encode_request(read_request().request), tentative=True)
    )
    transaction.on_data(REPLY[:2], 1.05)
    transaction.on_data(REPLY[2:5], 1.06)
    error = transaction.final_error()
    assert isinstance(error, NoReply) and (error.key, error.params["bytes"]) == ("bus.truncated", 5)


@pytest.mark.parametrize(
    "echo", [None, EchoFilter(WRITE_FRAME, tentative=False), EchoFilter(WRITE_FRAME, tentative=True)]
)
def test_silence_after_a_write_is_not_called_the_own_frame(echo: EchoFilter | None) -> None:
    """The user would look for an adapter with an echo instead of a drive without power."""
    error = make_transaction(WRITE, paced=False, echo=echo).final_error()
    assert isinstance(error, NoReply) and error.key == "bus.no_reply"


def test_the_frame_of_another_station_in_place_of_an_echo_is_not_called_the_own_frame() -> None:
    transaction = make_transaction(WRITE, paced=False, echo=EchoFilter(WRITE_FRAME, tentative=True))
    transaction.on_data(OTHERS, 1.05)
    error = transaction.final_error()
    assert transaction.foreign_frames and isinstance(error, NoReply) and error.key == "bus.no_reply"


@pytest.mark.parametrize("kind", [ChecksumError, AlphabetError, LineError, EchoError, TrailingError])
def test_only_damage_of_exactly_the_bytes_of_a_reply_is_a_damaged_reply(kind: type[DrivebusError]) -> None:
    """After any other error the reply may still come, so the request is not repeated at once."""
    transaction = make_transaction()
    for size in (12, 13, 14):
        transaction.received_count = size
        expected = size == 13 and kind in (ChecksumError, AlphabetError, LineError)
        assert transaction.is_damaged_reply(kind("of a reply")) is expected


@pytest.mark.parametrize(
    ("following", "second"),
    [(REPLY, True), (REPLY + b"\x00", True), (REPLY[:12], False), (DAMAGED, False), (OTHERS, False), (b"\x00", False)],
)
def test_only_a_whole_reply_behind_the_reply_is_a_second_one(following: bytes, second: bool) -> None:
    """A stray byte or a part of a frame is no sign of two drives at one address."""
    transaction = make_transaction()
    transaction.on_data(REPLY + following, 1.05)
    error = transaction.final_error()
    assert isinstance(error, TrailingError) and transaction.ends_with_second_reply(error) is second
