"""Names of what was received in place of a reply, from single transactions."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest

from drivebus.bus.core import BusCore, UntrustedReply
from drivebus.bus.failure_reason import failure_reason, late_reply_to_last_request, shows_a_reply
from drivebus.bus.prepared_request import PreparedRequest
from drivebus.bus.station import Station
from drivebus.bus.transaction import Transaction
from drivebus.errors import DrivebusError, EchoError, LengthError, NoReply
from drivebus.protocols import modbus
from drivebus.testing.bus_script import BusScript
from fixtures.bus import (
    CHARACTER_S,
    CODEC,
    COMMAND,
    STOP,
    FakeStation,
    make_core,
    read,
    read_request,
    stop_request,
    wire_to,
)

REPLY = CODEC.encode_reply(modbus.RegisterValues(1, 3, (1, 2, 3, 4)))
LATE_REPLY = CODEC.encode_reply(modbus.RegisterValues(1, 3, (1, 2)))
"""Reply to a read of two registers, where four are asked for."""


@pytest.fixture
def core() -> BusCore:
    return make_core(1)


@pytest.fixture
def station(core: BusCore) -> Station:
    return core.stations[1]


def reason_of(
    core: BusCore, *received: bytes, at: float = 3.0, untrusted: UntrustedReply | None = None
) -> DrivebusError:
    """Return the reason of a failed read of four registers that brought these pieces at that second.

    ``untrusted``: error of the bus for a reply that is whole.
    """
    prepared = PreparedRequest(read_request(), None, core.stations[1], core.settings)
    transaction = Transaction(prepared, at - 0.05, CHARACTER_S, has_line_timing=False, echo=None)
    for data in received:
        transaction.on_data(data, at)
    error = untrusted or transaction.final_error()
    assert error is not None
    reason = failure_reason(transaction, error)
    assert isinstance(reason, DrivebusError)
    return reason


def test_a_reply_to_an_older_read_is_called_late_by_the_newest_read_that_it_fits(
    core: BusCore, station: Station
) -> None:
    for second in (1.0, 2.0):
        station.remember_unanswered(read(count=2), second, second)
    station.remember_unanswered(read(count=3), 2.5, 2.5)
    reason = reason_of(core, LATE_REPLY)
    assert (reason.key, reason.params["milliseconds"]) == ("bus.late_reply", 1000)


@pytest.mark.parametrize(("received", "at"), [(LATE_REPLY, 6.0), (LATE_REPLY + b"?", 3.0), (LATE_REPLY[:-1], 3.0)])
def test_what_can_be_no_late_reply_is_not_called_one(
    core: BusCore, station: Station, received: bytes, at: float
) -> None:
    """Five seconds are the longest lateness; a late reply has no byte more or less."""
    station.remember_unanswered(read(count=2), 1.0, 1.0)
    assert isinstance(reason_of(core, received, at=at), LengthError)


def test_a_reply_to_the_last_request_is_late_however_long_ago_that_was(station: Station) -> None:
    assert late_reply_to_last_request(station, LATE_REPLY, 100.0) is None
    station.last_request, station.last_request_sent_at = read(count=2), 10.0
    found = late_reply_to_last_request(station, LATE_REPLY, 100.0)
    assert found is not None and found.params["milliseconds"] == 90_000
    for other in (LATE_REPLY + b"?", LATE_REPLY[:-1], REPLY):
        assert late_reply_to_last_request(station, other, 100.0) is None


@pytest.mark.parametrize("stray", [b"\xff", b"\x00\x01", b"abc", b"abcd"])
def test_up_to_four_stray_bytes_before_a_reply_are_named(core: BusCore, stray: bytes) -> None:
    reason = reason_of(core, stray + REPLY)
    assert (reason.key, reason.params["count"], reason.params["bytes"]) == (
        "bus.stray_before",
        len(stray),
        stray.hex(" ").upper(),
    )


@pytest.mark.parametrize("received", [b"abcde" + REPLY, b"?" + REPLY + b"?", b"?" + REPLY[:-1], b"??"])
def test_anything_else_before_a_reply_is_not_called_stray_bytes(core: BusCore, received: bytes) -> None:
    assert reason_of(core, received).key != "bus.stray_before"


def test_a_whole_reply_that_is_not_trusted_has_no_stray_bytes_before_it(core: BusCore) -> None:
    error = UntrustedReply("bus.suspect", station=1)
    assert reason_of(core, REPLY, untrusted=error) is error


def reply_of_station_2(count: int) -> bytes:
    return CODEC.encode_reply(modbus.RegisterValues(2, 3, (7,) * count))


@pytest.mark.parametrize("count", [4, 2])
def test_one_reply_under_another_address_is_named(core: BusCore, count: int) -> None:
    reason = reason_of(core, reply_of_station_2(count))
    assert (reason.key, reason.params["found"]) == ("bus.other_station_replied", 2)


@pytest.mark.parametrize("received", [(reply_of_station_2(4),) * 2, (reply_of_station_2(5),)])
def test_two_frames_of_another_station_or_a_longer_one_answer_another_request(
    core: BusCore, received: tuple[bytes, ...]
) -> None:
    """Another master talks with that station."""
    assert isinstance(reason_of(core, *received), NoReply)


@pytest.mark.parametrize(
    ("error", "shown"),
    [(None, False), (NoReply("bus.only_own_frame"), False), (NoReply("bus.truncated"), True), (OSError(), True)],
)
def test_everything_that_was_received_but_our_own_frame_shows_a_reply(error: Any, shown: bool) -> None:
    assert shows_a_reply(error) is shown


def test_a_drive_that_answers_every_stop_with_a_wrong_value_has_not_answered_twice() -> None:
    """The first such reply looks like a write of another master; the next ones were called late or second replies."""
    answers = wire_to(FakeStation())

    def with_wrong_value(frame: bytes, ended_at: float) -> Iterable[tuple[float, bytes]]:
        wrong = CODEC.encode_reply(modbus.WriteAck(1, 6, COMMAND, 0x1234))
        for at, reply in answers(frame, ended_at):
            yield at, wrong if isinstance(CODEC.decode_request(frame).message, modbus.WriteRegister) else reply

    script = BusScript(make_core(1), with_wrong_value)
    for number in range(3):
        script.submit(stop_request(1), number)
        script.run()
        error = script.result(number).error
        assert isinstance(error, EchoError) and (error.expected, error.found) == (STOP, 0x1234)
