"""A prepared request: attempts, priority and timeouts, computed once from its bytes."""

from __future__ import annotations

from typing import Any

import pytest

from drivebus.bus.messages import BusRequest, Permit, RequestPriority, RetryPolicy
from drivebus.bus.prepared_request import Poll, PreparedPoll, PreparedRequest, priority_of
from drivebus.bus.station import Station
from drivebus.errors import ChecksumError
from drivebus.protocols import modbus
from drivebus.protocols.codec import Complete, Effect, Incomplete
from fixtures.bus import CODEC, COMMAND, SETTINGS, START, STOP, TIMING, read, read_request, station_config

SPEED = 0x2001


def station(codec: Any = None) -> Station:
    return Station(station_config(1) if codec is None else station_config(1, codec=codec), SETTINGS)


def prepare(request: BusRequest, *, is_sync_probe: bool = False) -> PreparedRequest:
    return PreparedRequest(request, "token", station(), SETTINGS, is_sync_probe=is_sync_probe)


def permit(retry_policy: RetryPolicy, effect: Effect = Effect.SETTING) -> Permit:
    return Permit(station=1, effect=effect, retry_policy=retry_policy, expires_at=100.0, stop_epoch=0)


def write(register: int, value: int, given: Permit | None = None, address: int = 1) -> BusRequest:
    return BusRequest(
        station=1,
        request=modbus.WriteRegister(address, register, value),
        priority=RequestPriority.PARAMETER,
        permit=given,
    )


ATTEMPTS = [
    ("a read twice", read_request(), 2),
    ("a stop three times", write(COMMAND, STOP), 3),
    ("a stop three times, whatever its permit says", write(COMMAND, STOP, permit(RetryPolicy.EDGE_TRIGGERED)), 3),
    (
        "a start once, whatever its permit says",
        write(COMMAND, START, permit(RetryPolicy.IDEMPOTENT, Effect.MOTION)),
        1,
    ),
    ("a broadcast stop once", write(COMMAND, STOP, address=0), 1),
    ("an absolute setting three times", write(SPEED, 1, permit(RetryPolicy.IDEMPOTENT)), 3),
    ("an edge once", write(SPEED, 1, permit(RetryPolicy.EDGE_TRIGGERED)), 1),
    ("a setting without a permit once", write(SPEED, 1), 1),
    ("an EEPROM write once", write(SPEED, 1, permit(RetryPolicy.EEPROM)), 1),
]


@pytest.mark.parametrize(("ask", "attempts"), [row[1:] for row in ATTEMPTS], ids=[row[0] for row in ATTEMPTS])
def test_the_attempts_of_a_frame_follow_from_its_bytes_and_its_permit(ask: BusRequest, attempts: int) -> None:
    assert prepare(ask).max_attempts == attempts


def test_a_sync_probe_is_sent_once() -> None:
    """A probe that fails shows that the station is silent; a second one would show no more."""
    assert prepare(read_request(), is_sync_probe=True).max_attempts == 1


def test_a_stop_has_the_stop_priority_and_nothing_else_has() -> None:
    for priority in RequestPriority:
        ask = BusRequest(station=1, request=modbus.WriteRegister(1, COMMAND, STOP), priority=priority)
        assert prepare(ask).priority is RequestPriority.STOP
        assert priority_of(BusRequest(station=1, request=None, priority=priority), Effect.NONE) is (
            priority or RequestPriority.COMMAND
        )
        assert (
            prepare(BusRequest(station=1, request=modbus.WriteRegister(1, COMMAND, START), priority=priority)).priority
            is not RequestPriority.STOP
        )


def test_the_effect_of_a_request_is_decoded_from_its_bytes() -> None:
    prepared = prepare(read_request())
    assert (prepared.data, prepared.effect, prepared.reply_bytes, prepared.is_broadcast) == (
        modbus.ModbusRtuCodec().encode_request(read_request().request),
        Effect.NONE,
        13,
        False,
    )
    assert prepared.send_s == SETTINGS.seconds(8) and prepared.reply_timeout_s == TIMING.timeout_s(SETTINGS, 13)
    assert prepared.gap_s == TIMING.gap_s(SETTINGS)
    broadcast = prepare(write(COMMAND, STOP, address=0))
    assert (broadcast.reply_bytes, broadcast.is_broadcast, broadcast.reply_timeout_s) == (0, True, TIMING.turnaround_s)


def test_only_a_stop_loses_its_expiry() -> None:
    for request, expires_at in (
        (modbus.WriteRegister(1, COMMAND, STOP), None),
        (modbus.WriteRegister(1, COMMAND, START), 7.0),
        (read_request().request, 7.0),
    ):
        assert prepare(BusRequest(station=1, request=request, expires_at=7.0)).expires_at == expires_at


class FixedSizeCodec(modbus.ModbusRtuCodec):
    """A codec with a fixed reply size."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self.size = size

    def reply_size(self, request: Any, /) -> int:
        return self.size


@pytest.mark.parametrize(
    ("codec", "request_", "plain"),
    [
        (None, modbus.ReadRegisters(1, 7), True),
        (None, modbus.ReadRegisters(2, 7), False),
        (None, modbus.WriteRegister(1, SPEED, 7), False),
        (None, modbus.WriteRegister(1, COMMAND, STOP), False),
        (FixedSizeCodec(0), modbus.ReadRegisters(1, 7), False),
        (FixedSizeCodec(1), modbus.ReadRegisters(1, 7), True),
    ],
)
def test_only_a_read_of_this_very_station_is_cached(codec: Any, request_: Any, plain: bool) -> None:
    found = station(codec)
    assert found.encode(request_, SETTINGS).cacheable is plain
    assert (request_ in found.encode_cache) is plain


class CountingCodec(modbus.ModbusRtuCodec):
    decode_count = 0

    def decode_reply(self, request: modbus.ModbusRequest, data: bytes, /) -> Any:
        self.decode_count += 1
        return super().decode_reply(request, data)


def reply_with(first: int) -> bytes:
    return CODEC.encode_reply(modbus.RegisterValues(1, 3, (first, 2, 3, 4)))


def first_value(poll: PreparedPoll, data: bytes) -> int:
    result = poll.decode_reply(data)
    assert isinstance(result, Complete)
    return int(result.message.values[0])


def test_a_poll_decodes_a_repeated_reply_once_and_a_changed_one_again() -> None:
    codec = CountingCodec()
    poll = PreparedPoll(Poll(read(), 1.0), "token", station(codec), SETTINGS, 0.0)
    assert [first_value(poll, reply_with(first)) for first in (7, 7, 8, 7)] == [7, 7, 8, 7]
    assert codec.decode_count == 3


def test_a_damaged_or_partial_reply_after_a_whole_one_is_no_reply() -> None:
    poll = PreparedPoll(Poll(read(), 1.0), "token", station(), SETTINGS, 0.0)
    whole = reply_with(7)
    assert first_value(poll, whole) == 7
    with pytest.raises(ChecksumError):
        poll.decode_reply(whole[:-1] + bytes((whole[-1] ^ 1,)))
    assert isinstance(poll.decode_reply(whole[:-1]), Incomplete)
    assert isinstance(poll.decode_reply(b""), Incomplete)
    assert first_value(poll, whole) == 7
