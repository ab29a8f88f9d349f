"""Families on a bus: one by default; mixing is allowed only where no frame of one looks like a request of the other."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from drivebus.bus import TraceKind
from drivebus.bus.compatibility import check_compatible
from drivebus.bus.core import BusCore
from drivebus.bus.messages import StationConfig
from drivebus.errors import ConfigurationError, HeaderError
from drivebus.protocols import dzb100 as dzb
from drivebus.protocols import sunfar
from drivebus.protocols.codec import Complete, Effect
from drivebus.testing.bus_script import BusScript
from fixtures.bus import SETTINGS, TIMING, effect, station_config


class Anything:
    """Codec of a family in which any five bytes from 30H on are a request."""

    family = "anything"
    encoding = "raw"
    broadcast_address = None

    def encode_request(self, request: Any) -> bytes:
        return b"\x30\x01\x02\x03\x04"

    def decode_request(self, data: bytes) -> Complete:
        if data[:1] != b"\x30":
            raise HeaderError("protocols.header", expected=0x30, found=data[0])
        return Complete("obeyed", 5)


def c320(address: int = 5) -> StationConfig:
    codec = sunfar.SunfarCodec()
    return StationConfig(
        address=address,
        codec=codec,
        timing=TIMING,
        effect_of=lambda frame: Effect.NONE,
        sync_request=lambda n: sunfar.SunfarReadParameter(address, 1, n % 9),
    )


def dzb100(address: int = 6) -> StationConfig:
    codec = dzb.Dzb100Codec()
    return StationConfig(
        address=address,
        codec=codec,
        timing=TIMING,
        effect_of=lambda frame: Effect.NONE,
        sync_request=lambda n: dzb.Dzb100ReadParameter(address, n % 81),
    )


def test_a_second_family_is_rejected_by_default() -> None:
    bus = BusCore(SETTINGS)
    bus.registry.add(station_config(1))
    with pytest.raises(ConfigurationError) as caught:
        bus.registry.add(c320())
    assert caught.value.key == "bus.mixed"
    assert caught.value.params["found"] == "sunfar/ascii"
    assert list(bus.stations) == [1]


def test_the_first_station_of_another_protocol_is_named() -> None:
    with pytest.raises(ConfigurationError) as caught:
        check_compatible(station_config(1), [station_config(2), c320(), dzb100()], allow_mixed=False)
    params = {name: caught.value.params[name] for name in ("found", "expected", "address", "other")}
    assert params == {"found": "modbus/rtu", "expected": "sunfar/ascii", "address": 1, "other": 5}


def test_families_whose_frames_can_not_be_confused_may_be_mixed_on_purpose() -> None:
    bus = BusCore(SETTINGS, allow_mixed=True)
    for config in (station_config(1), c320(), dzb100()):
        bus.registry.add(config)
    assert sorted(bus.stations) == [1, 5, 6]


@pytest.mark.parametrize("order", [0, 1])
def test_a_frame_that_contains_the_others_request_is_rejected_at_every_offset(order: int) -> None:
    bus = BusCore(SETTINGS, allow_mixed=True)
    strange = replace(station_config(9), codec=Anything(), effect_of=lambda frame: Effect.NONE)
    pair = (c320(), strange)
    bus.registry.add(pair[order])
    with pytest.raises(ConfigurationError) as caught:
        bus.registry.add(pair[1 - order])
    assert caught.value.key == "bus.mixed_frame"
    params = {name: caught.value.params[name] for name in ("found", "expected", "address", "other")}
    assert params == {"found": "sunfar/ascii", "expected": "anything/raw", "address": 5, "other": 9}


def test_two_models_of_one_family_share_a_bus() -> None:
    bus = BusCore(SETTINGS)
    bus.registry.add(station_config(1))
    bus.registry.add(replace(station_config(2), effect_of=effect))
    assert len(bus.stations) == 2


@pytest.mark.parametrize("family", ["c320", "dzb100"])
def test_a_request_of_one_family_to_the_address_of_a_suspect_station_of_another_is_one_of_another_master(
    family: str,
) -> None:
    """It was decoded as a late reply of that station, whose codec cannot: an error ended the handling of the bytes."""
    core = BusCore(SETTINGS, allow_mixed=True)
    configs = [station_config(1), station_config(2), c320(), dzb100()]
    for config in configs:
        core.registry.add(config)
    core.scheduler.mark_suspect(core.stations[1], 0.0)
    script = BusScript(core)
    core.tracing = True
    other = {"c320": c320(1), "dzb100": dzb100(1)}[family]
    frame = other.codec.encode_request(other.sync_request(0))
    script.receive(frame, at=0.1)
    script.run_until(0.2)
    assert [(event.kind, event.station, event.data) for event in script.traced] == [
        (TraceKind.FOREIGN_REQUEST, None, frame)
    ]
