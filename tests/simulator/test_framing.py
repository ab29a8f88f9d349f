"""Framing of the stations: no bytes in any pieces raise or make a station execute a request it did not receive."""

from __future__ import annotations

import random
from collections.abc import Iterator

import pytest

from drivebus.protocols import modbus, sunfar
from drivebus.protocols.codec import Codec
from drivebus.serial_settings import SerialSettings
from drivebus.simulator.framing import FrameReceiver, FramingRule, ReceivedFrame
from drivebus.simulator.models.catalog import make_station
from drivebus.simulator.station import SimulatedStation

LINE = SerialSettings(9600)
RTU_RULE = FramingRule(gap_characters=3.5, ends_by_silence=True)
READ = modbus.ModbusRtuCodec().encode_request(modbus.ReadRegisters(1, 0x3000, 4))
KINDS = [("c320", {}), ("dzb100", {}), ("vc660", {}), ("df800", {}), ("df800", {"encoding": "ascii"})]


def rtu() -> FrameReceiver:
    return FrameReceiver((modbus.ModbusRtuCodec(),), RTU_RULE, LINE)


def received_frames(station: SimulatedStation, data: bytes) -> list[ReceivedFrame]:
    receiver = FrameReceiver(station.codecs, station.rule, LINE)
    return receiver.feed(data, 0, 1.0) + receiver.on_silence()


def execute(station: SimulatedStation, frame: ReceivedFrame, now: float) -> None:
    if frame.address == station.address:
        station.handle_frame(frame.message, frame.codec, LINE, now, error=frame.error)


def frames(codec: Codec, rng: random.Random) -> Iterator[bytes]:
    """Yield noise, and good requests with one to three wrong bytes."""
    for _ in range(150):
        yield rng.randbytes(rng.randrange(1, 40))
    for _ in range(250):
        if codec.family == "sunfar":
            good = bytearray(
                codec.encode_request(sunfar.SunfarWriteParameter(1, rng.randrange(16), rng.randrange(256), 7))
            )
        elif codec.family == "dzb100":
            good = bytearray(b"P\x03\x0101%02d%04X" % (rng.randrange(100), rng.randrange(0x10000)))
        else:
            good = bytearray(codec.encode_request(modbus.WriteRegister(1, rng.randrange(0x10000), 7)))
        for _ in range(rng.randrange(1, 4)):
            good[rng.randrange(len(good))] = rng.randrange(256)
        yield bytes(good)


@pytest.mark.parametrize(("model", "settings"), KINDS)
def test_no_bytes_make_a_station_raise_or_run(model: str, settings: dict[str, str]) -> None:
    station = make_station(model, 1, settings)
    rng = random.Random(11)
    for codec in station.codecs:
        for n, data in enumerate(frames(codec, rng)):
            for frame in received_frames(station, data):
                execute(station, frame, float(n))
    assert station.motor.starts == 0


@pytest.mark.parametrize("model", ["c320", "vc660", "df800"])
def test_every_decoded_request_can_be_encoded(model: str) -> None:
    station = make_station(model, 1)
    station.motor.ambient_c = station.motor.temperature_c = -20.0
    codec = station.codecs[0]
    if model == "c320":
        requests = [sunfar.ReadMonitor(1, item) for item in range(256)]
        requests += [sunfar.SunfarReadParameter(1, group, item) for group in range(16) for item in range(256)]
    else:
        requests = [modbus.ReadRegisters(1, register) for register in range(0x3100)]
    for request in requests:
        [frame] = received_frames(station, codec.encode_request(request))
        reply = station.handle_frame(frame.message, codec, LINE, 0.0, error=frame.error)
        assert reply is not None and reply.data


def test_a_frame_is_received_whole_or_in_pieces() -> None:
    receiver = rtu()
    receiver.feed(READ[:3], 0, 1.0)
    receiver.feed(READ[3:], 0, LINE.seconds(2))
    [frame] = receiver.on_silence()
    assert frame.frame == READ and not frame.short_gap


def test_silence_of_the_gap_begins_a_new_frame() -> None:
    receiver = rtu()
    receiver.feed(READ[:3], 0, 1.0)
    receiver.feed(READ, 0, LINE.seconds(3.5))
    assert [frame.frame for frame in receiver.on_silence()] == [READ]


def test_a_line_error_invalidates_its_frame_and_not_the_next() -> None:
    receiver = rtu()
    receiver.feed(READ, 1, 1.0)
    assert receiver.on_silence() == []
    receiver.feed(READ, 0, 1.0)
    assert len(receiver.on_silence()) == 1


def test_a_short_gap_is_reported() -> None:
    receiver = rtu()
    receiver.feed(READ, 0, LINE.seconds(3.0))
    [frame] = receiver.on_silence()
    assert frame.short_gap
    assert frame.silence_s == LINE.seconds(3.0)


def test_jitter_up_to_the_tolerance_is_no_short_gap() -> None:
    receiver = FrameReceiver((modbus.ModbusRtuCodec(),), RTU_RULE, LINE, tolerance_s=0.001)
    receiver.feed(READ, 0, receiver.gap_s - 0.0009)
    [frame] = receiver.on_silence()
    assert not frame.short_gap


def test_bytes_after_a_c320_frame_without_silence_are_ignored() -> None:
    station = make_station("c320", 1)
    receiver = FrameReceiver(station.codecs, station.rule, LINE)
    frame = station.codecs[0].encode_request(sunfar.ReadMonitor(1, 0))
    assert len(receiver.feed(frame + frame, 0, 1.0)) == 1
    assert receiver.feed(frame, 0, LINE.seconds(1)) == []
    assert len(receiver.feed(frame, 0, LINE.seconds(5))) == 1


def test_a_c320_recognizes_both_encodings_by_their_head() -> None:
    station = make_station("c320", 1)
    for codec in station.codecs:
        [frame] = received_frames(station, codec.encode_request(sunfar.ReadMonitor(1, 0)))
        assert frame.codec is codec
