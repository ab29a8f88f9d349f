"""The detector of echoes alone: what each kind of finished transaction shows, and what it leaves open."""

from __future__ import annotations

import struct

import pytest

from drivebus.bus.echo import EchoDetector, EchoState
from drivebus.bus.messages import BusRequest
from drivebus.bus.prepared_request import PreparedRequest
from drivebus.bus.transaction import Transaction
from drivebus.protocols import modbus
from fixtures.bus import CHARACTER_S, CODEC, FakeStation, make_core, read_request, stop_request, write_request

CORE = make_core(1, echo="detect")
READ = read_request()
WRITE = write_request(CORE)
"""Write whose reply equals it."""
BROADCAST = stop_request(0)


def prepared_for(request: BusRequest) -> PreparedRequest:
    return PreparedRequest(request, None, CORE.stations[1], CORE.settings)


def frame_of(request: BusRequest) -> bytes:
    return CODEC.encode_request(request.request)


def reply_to(request: BusRequest) -> bytes:
    reply = FakeStation().reply_to(frame_of(request), 0.0)
    assert reply is not None
    return reply


def finish(echo: EchoDetector, request: BusRequest, received: bytes = b"", *, early: bytes = b"") -> None:
    """Finish a transaction as the bus does. ``early``: bytes received before the last bit of the request."""
    prepared = prepared_for(request)
    filter = echo.filter_for(prepared)
    transaction = Transaction(prepared, 0.0, CHARACTER_S, has_line_timing=bool(early), echo=filter)
    for data, at in ((early, transaction.tx_end_at - CHARACTER_S), (received, transaction.tx_end_at + 0.03)):
        transaction.on_data(data, at)
    if transaction.final_error() is None:
        echo.accepts(transaction)
    echo.observe(transaction)


def is_tentative(echo: EchoDetector, request: BusRequest) -> bool | None:
    """Return whether a changed echo would only show that there is none; None where no echo is expected."""
    filter = echo.filter_for(prepared_for(request))
    return None if filter is None else filter.tentative


def echoing(setting: str = "detect") -> EchoDetector:
    """Return the detector after a read with its echo and its reply."""
    echo = EchoDetector(setting)
    finish(echo, READ, frame_of(READ) + reply_to(READ))
    assert (echo.state, echo.echo_count) == (EchoState.ON, 1)
    return echo


def assuming() -> EchoDetector:
    """Return the detector after a write that was received twice: as echo and reply, or as a doubled reply."""
    echo = EchoDetector("detect")
    finish(echo, WRITE, frame_of(WRITE) * 2)
    assert echo.state is EchoState.ON
    return echo


def test_three_frames_in_a_row_without_their_echo_make_it_uncertain() -> None:
    echo = echoing()
    for _ in range(2):
        finish(echo, READ)
    finish(echo, READ, frame_of(READ))
    for _ in range(2):
        finish(echo, READ)
        assert echo.state is EchoState.ON, "the frames after the echo are counted from zero"
    finish(echo, READ)
    assert echo.state is EchoState.UNKNOWN


def test_frames_without_echo_are_counted_from_zero_after_the_port_was_opened_again() -> None:
    echo = echoing()
    for _ in range(2):
        finish(echo, READ)
    echo.reset()
    finish(echo, WRITE, frame_of(WRITE)[-1:], early=frame_of(WRITE)[:-1])
    for _ in range(2):
        finish(echo, READ)
        assert echo.state is EchoState.ON
    finish(echo, READ)
    assert echo.state is EchoState.UNKNOWN


@pytest.mark.parametrize("setting", ["on", "off"])
def test_a_setting_of_the_user_stays(setting: str) -> None:
    """Whatever is received: the user may know the adapter better."""
    echo = EchoDetector(setting)
    for _ in range(4):
        finish(echo, READ)
    finish(echo, WRITE, frame_of(WRITE)[-1:], early=frame_of(WRITE)[:-1])
    finish(echo, WRITE, frame_of(WRITE) * 2)
    finish(echo, WRITE, frame_of(WRITE))
    echo.record_repeat(frame_of(WRITE))
    assert echo.state is EchoState(setting)
    echo.reset()
    assert echo.state is EchoState(setting)


def test_a_read_whose_reply_was_received_alone_rules_the_echo_out_and_a_silent_or_damaged_one_does_not() -> None:
    echo = EchoDetector("detect")
    for received in (b"", frame_of(READ)[:2], reply_to(READ)[:-1], reply_to(READ)[:-1] + b"?"):
        finish(echo, READ, received)
        assert echo.state is EchoState.UNKNOWN, received
    finish(echo, READ, reply_to(READ))
    assert echo.state is EchoState.OFF and echo.ruled_out


def test_the_silence_after_a_broadcast_rules_no_echo_out() -> None:
    echo = EchoDetector("detect")
    finish(echo, BROADCAST)
    assert echo.state is EchoState.UNKNOWN


def test_only_an_echo_that_was_assumed_from_a_doubled_frame_is_tentative_until_a_read_had_it() -> None:
    echo = assuming()
    assert (is_tentative(echo, WRITE), is_tentative(echo, READ)) == (False, True)
    finish(echo, WRITE, frame_of(WRITE) * 2)
    assert is_tentative(echo, READ), "another write proves no more"
    finish(echo, READ, frame_of(READ) + reply_to(READ))
    finish(echo, WRITE, frame_of(WRITE) * 2)
    assert is_tentative(echo, READ) is False


def test_an_assumed_echo_is_dropped_by_a_read_without_it() -> None:
    echo = assuming()
    finish(echo, READ, reply_to(READ))
    assert echo.state is EchoState.OFF and echo.ruled_out
    finish(echo, WRITE, frame_of(WRITE)[-1:], early=frame_of(WRITE)[:-1])
    assert is_tentative(echo, READ) is False


def test_a_frame_received_before_its_own_last_bit_is_an_echo_without_doubt() -> None:
    for reply in (b"", reply_to(WRITE), reply_to(WRITE)[:3]):
        echo = EchoDetector("detect")
        finish(echo, WRITE, frame_of(WRITE)[-1:] + reply, early=frame_of(WRITE)[:-1])
        assert echo.state is EchoState.ON and is_tentative(echo, READ) is False


@pytest.mark.parametrize(("before", "after", "is_echo"), [(b"", b"?", True), (b"?", b"", False)])
def test_only_a_frame_that_begins_with_our_own_twice_is_taken_for_echo_and_reply(
    before: bytes, after: bytes, is_echo: bool
) -> None:
    echo = EchoDetector("detect")
    finish(echo, WRITE, before + frame_of(WRITE) * 2 + after)
    assert (echo.state is EchoState.ON) == is_echo


def test_a_frame_in_place_of_a_reply_shows_an_echo_that_was_ruled_out() -> None:
    echo = EchoDetector("detect")
    finish(echo, READ, reply_to(READ))
    assert is_tentative(echo, READ) is None
    finish(echo, READ, frame_of(READ))
    assert echo.state is EchoState.ON and not echo.ruled_out and is_tentative(echo, READ) is False


def test_a_repeat_of_a_mirrored_frame_is_taken_for_its_reply_only_while_an_echo_is_possible() -> None:
    echo = EchoDetector("detect")
    echo.record_repeat(b"")
    assert echo.state is EchoState.UNKNOWN
    finish(echo, WRITE, frame_of(WRITE))
    echo.record_repeat(frame_of(READ))
    assert echo.state is EchoState.UNKNOWN
    echo.record_repeat(frame_of(WRITE))
    assert echo.state is EchoState.ON and is_tentative(echo, READ)
    finish(echo, READ, reply_to(READ))
    finish(echo, WRITE, frame_of(WRITE))
    echo.record_repeat(frame_of(WRITE))
    assert echo.state is EchoState.OFF, "another master writes the same value: the echo is ruled out"


def test_a_good_reply_whose_values_spell_its_request_shows_no_echo() -> None:
    echo = EchoDetector("detect")
    finish(echo, READ, reply_to(READ))
    values = struct.unpack(">4H", frame_of(READ))
    finish(echo, READ, CODEC.encode_reply(modbus.RegisterValues(1, 3, values)))
    assert echo.state is EchoState.OFF
