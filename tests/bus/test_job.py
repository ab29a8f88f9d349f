"""A job is computed once, of its bytes: how often it may go, in which lane, how long it waits (F10, F16, I3)."""

from __future__ import annotations

from typing import Any

import pytest

from buskit import COMMAND, LINE, START, STOP, TIMING, ask_read, link
from drivebus.bus.job import Job, lane_of, prepared
from drivebus.bus.stations import Station
from drivebus.message import Ask, Effect, Lane, Permit, WriteClass
from drivebus.protocols import modbus

SPEED = 0x2001


def station(codec: Any = None) -> Station:
    return Station(link(1) if codec is None else link(1, codec=codec), LINE)


def job(ask: Ask, *, fence: bool = False) -> Job:
    return Job(ask, "token", station(), LINE, fence=fence)


def permit(write_class: WriteClass, effect: Effect = Effect.SETTING) -> Permit:
    return Permit(1, effect, write_class, 100.0, 0)


def write(register: int, value: int, write_class: WriteClass, given: Permit | None = None, address: int = 1) -> Ask:
    return Ask(1, modbus.WriteRegister(address, register, value), Lane.PARAMETER, write_class, given)


ATTEMPTS = [
    ("a read twice", ask_read(), 2),
    ("a stop three times", write(COMMAND, STOP, WriteClass.EDGE), 3),
    (
        "a start once, whatever it is called",
        write(COMMAND, START, WriteClass.ABSOLUTE, permit(WriteClass.ABSOLUTE, Effect.MOTION)),
        1,
    ),
    ("a broadcast stop once", write(COMMAND, STOP, WriteClass.ABSOLUTE, address=0), 1),
    ("an absolute setting three times", write(SPEED, 1, WriteClass.EDGE, permit(WriteClass.ABSOLUTE)), 3),
    ("an edge once, whatever the ask says", write(SPEED, 1, WriteClass.ABSOLUTE, permit(WriteClass.EDGE)), 1),
    ("without a permit what the ask says: absolute", write(SPEED, 1, WriteClass.ABSOLUTE), 3),
    ("without a permit what the ask says: edge", write(SPEED, 1, WriteClass.EDGE), 1),
    ("an EEPROM write once", write(SPEED, 1, WriteClass.EEPROM, permit(WriteClass.EEPROM)), 1),
]


@pytest.mark.parametrize(("ask", "attempts"), [row[1:] for row in ATTEMPTS], ids=[row[0] for row in ATTEMPTS])
def test_f16_how_often_a_frame_may_go_is_told_by_its_bytes_and_its_permit(ask: Ask, attempts: int) -> None:
    assert job(ask).attempts_allowed == attempts


def test_a_fence_goes_once() -> None:
    """Its failure says that the station is silent; sending it again would say nothing more."""
    assert job(ask_read(), fence=True).attempts_allowed == 1


def test_i3_a_stop_has_the_stop_lane_and_nothing_else_has() -> None:
    for lane in Lane:
        ask = Ask(1, modbus.WriteRegister(1, COMMAND, STOP), lane)
        assert job(ask).lane is Lane.STOP
        assert lane_of(Ask(1, None, lane), Effect.NONE) is (lane or Lane.COMMAND)
        assert job(Ask(1, modbus.WriteRegister(1, COMMAND, START), lane)).lane is not Lane.STOP


def test_what_it_costs_is_that_of_its_bytes() -> None:
    one = job(ask_read())
    assert (one.data, one.effect, one.reply_bytes, one.broadcast) == (
        modbus.RtuCodec().encode_request(ask_read().request), Effect.NONE, 13, False,
    )  # fmt: skip
    assert one.send_s == LINE.seconds(8) and one.wait_s == TIMING.timeout_s(LINE, 13)
    assert (one.gap_s, one.adapter_s) == (TIMING.gap_s(LINE), TIMING.adapter_s)
    everybody = job(write(COMMAND, STOP, WriteClass.ABSOLUTE, address=0))
    assert (everybody.reply_bytes, everybody.broadcast, everybody.wait_s) == (0, True, TIMING.turnaround_s)


def test_only_a_stop_loses_its_expiry() -> None:
    """Ruling 5."""
    for request, expires_at in (
        (modbus.WriteRegister(1, COMMAND, STOP), None),
        (modbus.WriteRegister(1, COMMAND, START), 7.0),
        (ask_read().request, 7.0),
    ):
        assert job(Ask(1, request, expires_at=7.0)).expires_at == expires_at


class Terse(modbus.RtuCodec):
    """A codec whose reads are answered with so many bytes."""

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
        (Terse(0), modbus.ReadRegisters(1, 7), False),
        (Terse(1), modbus.ReadRegisters(1, 7), True),
    ],
)
def test_only_a_read_that_this_very_station_answers_is_remembered(codec: Any, request_: Any, plain: bool) -> None:
    one = station(codec)
    assert prepared(request_, one, LINE)[5] is plain
    assert (request_ in one.prepared) is plain
