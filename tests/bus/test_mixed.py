"""One family per line; mixing is allowed only where no frame of one looks like a request of the other (T18)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from buskit import LINE, TIMING, effect, link
from drivebus.bus.core import BusCore
from drivebus.errors import ConfigurationError, HeaderError
from drivebus.message import Complete, Effect, StationLink
from drivebus.protocols import dzb, sifang


class Anything:
    """A family whose stations take five bytes beginning with 30H for a request."""

    family = "anything"
    encoding = "raw"
    broadcast_address = None

    def encode_request(self, request: Any) -> bytes:
        return b"\x30\x01\x02\x03\x04"

    def decode_request(self, data: bytes) -> Complete:
        if data[:1] != b"\x30":
            raise HeaderError("protocols.header", expected=0x30, found=data[0])
        return Complete("obeyed", 5)


def c320(address: int = 5) -> StationLink:
    codec = sifang.SifangCodec()
    return StationLink(
        address, codec, TIMING, lambda frame: Effect.NONE, lambda n: sifang.ReadParameter(address, 1, n % 9)
    )


def dzb100(address: int = 6) -> StationLink:
    codec = dzb.DzbCodec()
    return StationLink(address, codec, TIMING, lambda frame: Effect.NONE, lambda n: dzb.ReadParameter(address, n % 81))


def test_a_second_family_is_refused_by_default() -> None:
    bus = BusCore(LINE)
    bus.add(link(1))
    with pytest.raises(ConfigurationError) as caught:
        bus.add(c320())
    assert caught.value.key == "bus.mixed"
    assert caught.value.params["found"] == "c320/ascii"
    assert list(bus.stations) == [1]


def test_families_whose_frames_can_not_be_confused_may_be_mixed_on_purpose() -> None:
    bus = BusCore(LINE, allow_mixed=True)
    for one in (link(1), c320(), dzb100()):
        bus.add(one)
    assert sorted(bus.stations) == [1, 5, 6]


@pytest.mark.parametrize("order", [0, 1])
def test_a_frame_that_contains_the_others_request_is_refused_at_every_offset(order: int) -> None:
    bus = BusCore(LINE, allow_mixed=True)
    strange = replace(link(9), codec=Anything())
    pair = (c320(), strange)
    bus.add(pair[order])
    with pytest.raises(ConfigurationError) as caught:
        bus.add(pair[1 - order])
    assert caught.value.key == "bus.mixed_frame"
    assert caught.value.params["address"] == 5 and caught.value.params["other"] == 9


def test_two_models_of_one_family_share_a_line() -> None:
    bus = BusCore(LINE)
    bus.add(link(1))
    bus.add(replace(link(2), effect=effect))
    assert len(bus.stations) == 2
