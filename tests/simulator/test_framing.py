"""How stations hear: any bytes, in any pieces, never raise, never make a station do what it was not told."""

from __future__ import annotations

import random
from collections.abc import Iterator

import pytest

from drivebus.protocols import modbus, sunfar
from drivebus.protocols.codec import Codec
from drivebus.serial_settings import SerialSettings
from drivebus.simulator.framing import FrameReceiver, FramingRule, ReceivedFrame
from drivebus.simulator.models.catalog import make_station
from drivebus.simulator.station import Station

LINE = SerialSettings(9600)
RTU_RULE = FramingRule(3.5, ends_by_silence=True)
READ = modbus.ModbusRtuCodec().encode_request(modbus.ReadRegisters(1, 0x3000, 4))
KINDS = [("c320", {}), ("dzb100", {}), ("vc660", {}), ("df800", {}), ("df800", {"encoding": "ascii"})]


def rtu() -> FrameReceiver:
    return FrameReceiver((modbus.ModbusRtuCodec(),), RTU_RULE, LINE)


def hears(station: Station, data: bytes) -> list[ReceivedFrame]:
    ear = FrameReceiver(station.codecs, station.rule, LINE)
    return ear.feed(data, 0, 1.0) + ear.on_silence()


def obeyed(station: Station, frame: ReceivedFrame, now: float) -> None:
    if frame.address == station.address:
        station.handle_frame(frame.message, frame.codec, LINE, now, error=frame.error)


def frames(codec: Codec, rng: random.Random) -> Iterator[bytes]:
    """Noise, and good requests with one to three wrong bytes."""
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
            for frame in hears(station, data):
                obeyed(station, frame, float(n))
    assert station.motor.starts == 0


@pytest.mark.parametrize("model", ["c320", "vc660", "df800"])
def test_whatever_is_read_can_be_sent(model: str) -> None:
    station = make_station(model, 1)
    station.motor.ambient_c = station.motor.temperature_c = -20.0
    codec = station.codecs[0]
    if model == "c320":
        requests = [sunfar.ReadMonitor(1, item) for item in range(256)]
        requests += [sunfar.SunfarReadParameter(1, group, item) for group in range(16) for item in range(256)]
    else:
        requests = [modbus.ReadRegisters(1, register) for register in range(0x3100)]
    for request in requests:
        [frame] = hears(station, codec.encode_request(request))
        text = station.handle_frame(frame.message, codec, LINE, 0.0, error=frame.error)
        assert text is not None and text.data


def test_a_frame_is_heard_whole_or_in_pieces() -> None:
    ear = rtu()
    ear.feed(READ[:3], 0, 1.0)
    ear.feed(READ[3:], 0, LINE.seconds(2))
    [received] = ear.on_silence()
    assert received.frame == READ and not received.short_gap


def test_a_pause_of_the_gap_begins_afresh() -> None:
    ear = rtu()
    ear.feed(READ[:3], 0, 1.0)
    ear.feed(READ, 0, LINE.seconds(3.5))
    assert [received.frame for received in ear.on_silence()] == [READ]


def test_a_marked_byte_voids_its_frame_and_not_the_next() -> None:
    ear = rtu()
    ear.feed(READ, 1, 1.0)
    assert ear.on_silence() == []
    ear.feed(READ, 0, 1.0)
    assert len(ear.on_silence()) == 1


def test_a_short_gap_is_told() -> None:
    ear = rtu()
    ear.feed(READ, 0, LINE.seconds(3.0))
    [received] = ear.on_silence()
    assert received.short_gap
    assert received.silence_s == LINE.seconds(3.0)


def test_jitter_up_to_the_tolerance_is_no_short_gap() -> None:
    ear = FrameReceiver((modbus.ModbusRtuCodec(),), RTU_RULE, LINE, tolerance_s=0.001)
    ear.feed(READ, 0, ear.gap_s - 0.0009)
    [received] = ear.on_silence()
    assert not received.short_gap


def test_what_follows_a_c320_frame_without_silence_is_not_recognised() -> None:
    station = make_station("c320", 1)
    ear = FrameReceiver(station.codecs, station.rule, LINE)
    frame = station.codecs[0].encode_request(sunfar.ReadMonitor(1, 0))
    assert len(ear.feed(frame + frame, 0, 1.0)) == 1
    assert ear.feed(frame, 0, LINE.seconds(1)) == []
    assert len(ear.feed(frame, 0, LINE.seconds(5))) == 1


def test_a_c320_hears_both_encodings_by_their_head() -> None:
    station = make_station("c320", 1)
    for codec in station.codecs:
        [received] = hears(station, codec.encode_request(sunfar.ReadMonitor(1, 0)))
        assert received.codec is codec
