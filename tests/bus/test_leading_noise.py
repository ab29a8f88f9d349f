"""Stray byte before a reply: strict at offset 0, unless the station's profile tolerates noise."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import pytest

from drivebus.errors import ProtocolError
from drivebus.serial_settings import StationTiming
from drivebus.testing.bus_script import BusScript
from fixtures.bus import TIMING, Delivery, FakeStation, byte_by_byte, make_core, read_request, whole, wire_to

GLITCHING = replace(TIMING, tolerate_leading_noise=True)


def behind(junk: bytes, deliver: Delivery) -> Delivery:
    def delivered(reply: bytes, begins_at: float) -> Iterable[tuple[float, bytes]]:
        return deliver(junk + reply, begins_at)

    return delivered


def receive_after_noise(junk: bytes, deliver: Delivery, timing: StationTiming) -> BusScript:
    station = FakeStation()
    script = BusScript(make_core(timing=timing), wire_to(station, deliver=behind(junk, deliver)))
    script.submit(read_request())
    return script


@pytest.mark.parametrize("deliver", [whole, byte_by_byte])
@pytest.mark.parametrize("junk", [b"\x00", b"\xff", b"\x01", b"\x02"])
def test_a_stray_byte_is_skipped_where_the_profile_tolerates_it(junk: bytes, deliver: Delivery) -> None:
    result = receive_after_noise(junk, deliver, GLITCHING).result()
    assert result.error is None
    assert len(result.reply.values) == 4


@pytest.mark.parametrize("address", [1, 7, 48])
def test_a_meaning_of_the_bytes_with_the_stray_byte_is_ignored(address: int) -> None:
    """With the stray byte the address is in the place of the function, and an unknown function has no known length."""
    station = FakeStation(address=address)
    script = BusScript(make_core(address, timing=GLITCHING), wire_to(station, deliver=behind(b"\x02", whole)))
    script.submit(read_request(address))
    assert script.result().error is None


@pytest.mark.parametrize("deliver", [whole, byte_by_byte])
def test_two_stray_bytes_are_too_many(deliver: Delivery) -> None:
    assert receive_after_noise(b"\x00\x00", deliver, GLITCHING).result().error is not None


@pytest.mark.parametrize("deliver", [whole, byte_by_byte])
def test_without_tolerance_a_stray_byte_invalidates_the_reply(deliver: Delivery) -> None:
    assert isinstance(receive_after_noise(b"\x00", deliver, TIMING).result().error, ProtocolError)
