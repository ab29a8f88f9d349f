"""Wire of the simulated bus: character times, collisions, noise, echo, lateness; time is an argument."""

from __future__ import annotations

import random

import pytest

from drivebus.errors import ConfigurationError
from drivebus.serial_settings import SerialSettings
from drivebus.simulator.line_quality import LineQuality, parse_line_quality
from drivebus.simulator.wire import Side, Wire

LINE = SerialSettings(9600, 8, "N")
CHARACTER_S = 10 / 9600
BOTH = (Side.MASTERS, Side.STATIONS)


def wire(line_quality: str = "", line: SerialSettings = LINE, seed: int = 1) -> Wire:
    return Wire(line, parse_line_quality(line_quality), random.Random(seed))


def arrivals(w: Wire, side: Side = Side.MASTERS) -> list[tuple[float, bytes, int]]:
    found = []
    while (at := w.next_event_at()) is not None:
        event = w.pop_event(at)
        assert event is not None
        _, _, event_side, transmission, first, last, _ = event
        if event_side is side:
            found.append((at, *transmission.received(first, last)))
    return found


def test_a_frame_arrives_when_its_last_stop_bit_has_ended() -> None:
    w = wire()
    w.transmit("master", b"12345678", 1.0, BOTH)
    assert w.next_event_at() == pytest.approx(1.0 + 8 * CHARACTER_S)
    assert arrivals(w) == [(pytest.approx(1.0 + 8 * CHARACTER_S), b"12345678", 0)]


def test_parity_makes_a_character_eleven_bits_long() -> None:
    w = wire(line=SerialSettings(9600, 8, "E"))
    w.transmit("master", b"12345678", 0.0, BOTH)
    assert w.next_event_at() == pytest.approx(8 * 11 / 9600)


def test_bytes_arrive_singly_each_at_its_own_time() -> None:
    w = wire("bytes")
    w.transmit("station", b"abc", 0.0, (Side.MASTERS,))
    assert arrivals(w) == [(pytest.approx((n + 1) * CHARACTER_S), b"abc"[n : n + 1], 0) for n in range(3)]


def test_an_adapter_delivers_bytes_in_batches_of_16_ms() -> None:
    w = wire("batch=16")
    data = bytes(range(32))
    w.transmit("station", data, 0.001, (Side.MASTERS,))
    found = arrivals(w)
    assert [at for at, _, _ in found] == [pytest.approx(0.016), pytest.approx(0.032), pytest.approx(0.048)]
    assert b"".join(chunk for _, chunk, _ in found) == data


def test_bytes_written_while_the_line_is_busy_follow_without_a_pause() -> None:
    w = wire()
    first = w.transmit("master", b"1234", 0.0, BOTH)
    second = w.transmit("master", b"56", 0.001, BOTH)
    assert second.start == first.end
    assert second.silence_s == pytest.approx(0.0)
    assert w.collisions == 0


def test_the_silence_before_a_frame_is_measured_from_the_last_transmitter() -> None:
    w = wire()
    w.transmit("master", b"1234", 0.0, BOTH)
    reply = w.transmit("station", b"5678", 0.01, (Side.MASTERS,))
    request = w.transmit("master", b"1234", reply.end + 0.002, BOTH)
    assert reply.silence_s == pytest.approx(0.01 - 4 * CHARACTER_S)
    assert request.silence_s == pytest.approx(0.002)


def test_two_transmissions_at_once_corrupt_each_other() -> None:
    w = wire()
    w.transmit("one", bytes(10), 0.0, BOTH)
    w.transmit("two", bytes([255]) * 10, 5 * CHARACTER_S, BOTH)
    first, second = (data for _, data, _ in arrivals(w))
    assert w.collisions == 1
    assert first[:5] == bytes(5)
    assert first[5:] != bytes(5)
    assert second == bytes([255]) * 5  # its first five characters are lost


def test_bytes_delivered_before_a_collision_stay_delivered() -> None:
    w = wire("bytes")
    w.transmit("one", bytes(4), 0.0, BOTH)
    assert w.pop_event(CHARACTER_S) is not None
    w.transmit("two", b"\xff\xff", 1.5 * CHARACTER_S, BOTH)
    later = [data for _, data, _ in arrivals(w)]
    assert later[0] != b"\x00"


def test_half_of_a_collision_is_noticed_by_parity() -> None:
    w = wire(line=SerialSettings(9600, 8, "E"))
    w.transmit("one", bytes(200), 0.0, BOTH)
    w.transmit("two", bytes(200), 0.0, BOTH)
    assert 60 < sum(line_errors for _, _, line_errors in arrivals(w)) < 140


def test_a_lost_frame_reaches_no_receiver() -> None:
    w = wire("loss=1")
    w.transmit("master", b"1234", 0.0, BOTH)
    assert w.next_event_at() is None


def test_a_flipped_bit_is_a_line_error_with_parity_and_undetected_without() -> None:
    for line, marked in ((SerialSettings(9600, 8, "E"), True), (LINE, False)):
        w = wire("flip=1", line)
        w.transmit("master", bytes(50), 0.0, BOTH)
        [(_, data, line_errors)] = arrivals(w)
        assert all(byte.bit_count() == 1 for byte in data)
        assert line_errors == (50 if marked else 0)


def test_a_late_reply_arrives_late_but_complete() -> None:
    w = wire("late=1:0.4")
    w.transmit_reply("station", b"1234", 0.0, 0.0)
    [(at, data, _)] = arrivals(w)
    assert 4 * CHARACTER_S < at < 0.4 + 4 * CHARACTER_S
    assert data == b"1234"


def test_late_replies_of_one_station_arrive_in_order() -> None:
    w = wire("late=0.5:5", seed=3)
    for n in range(50):
        w.transmit_reply("station", bytes((n,)), n * 0.1, n * 0.1)
    assert b"".join(data for _, data, _ in arrivals(w)) == bytes(range(50))
    assert w.collisions == 0


def test_a_duplicate_reply_arrives_twice() -> None:
    w = wire("duplicate=1")
    w.transmit_reply("station", b"1234", 0.0, 0.0)
    assert [data for _, data, _ in arrivals(w)] == [b"1234", b"1234"]


def test_the_driver_can_cut_the_first_and_the_last_byte() -> None:
    for line_quality, expected in (("cut_first=1", b"234"), ("cut_last=1", b"123")):
        w = wire(line_quality)
        w.transmit("station", b"1234", 0.0, (Side.MASTERS,))
        assert [data for _, data, _ in arrivals(w)] == [expected]


def test_a_stray_byte_can_precede_a_reply() -> None:
    w = wire("junk=1")
    w.transmit_reply("station", b"1234", 0.0, 0.0)
    [(_, data, _)] = arrivals(w)
    assert len(data) == 5 and data[1:] == b"1234"


def test_a_wrong_baud_rate_is_unreadable() -> None:
    w = wire()
    w.transmit("master", b"12345678", 0.0, BOTH, SerialSettings(19200))
    [(at, data, line_errors)] = arrivals(w)
    assert at == pytest.approx(8 * 10 / 19200)
    assert data != b"12345678" and line_errors == 8


def test_nothing_passes_an_unplugged_wire() -> None:
    w = wire()
    w.plugged = False
    w.transmit("station", b"1234", 0.0, (Side.MASTERS,))
    assert w.next_event_at() is None


def test_the_same_seed_gives_the_same_bytes() -> None:
    def noisy_arrivals(seed: int) -> list[tuple[float, bytes, int]]:
        w = wire("noisy,late=0.3:0.2,duplicate=0.1", seed=seed)
        for n in range(200):
            w.transmit_reply("station", bytes(range(12)), n * 1.0, n * 1.0)
        return arrivals(w)

    assert noisy_arrivals(7) == noisy_arrivals(7)
    assert noisy_arrivals(7) != noisy_arrivals(8)


def test_a_clean_line_uses_no_random_numbers() -> None:
    w = Wire(LINE, LineQuality(), UnusedRng())
    w.transmit_reply("station", b"1234", 0.0, 0.0)
    assert [data for _, data, _ in arrivals(w)] == [b"1234"]


class UnusedRng:
    def random(self) -> float:
        raise AssertionError

    def randrange(self, start: int, stop: int, /) -> int:
        raise AssertionError


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("clean", LineQuality()),
        ("", LineQuality()),
        ("bytes", LineQuality(per_byte=True)),
        ("echo,bytes", LineQuality(per_byte=True, echo=True)),
        ("lossy", LineQuality(loss=0.05, flip=0.001)),
        ("late", LineQuality(late=0.1, late_s=0.4)),
        ("late=0.2:1.5", LineQuality(late=0.2, late_s=1.5)),
        (
            "loss=0.05,flip=0.001,late=0.1:0.4,batch=16",
            LineQuality(loss=0.05, flip=0.001, late=0.1, late_s=0.4, batch_s=0.016),
        ),
        ("lossy,loss=0.5", LineQuality(loss=0.5, flip=0.001)),
    ],
)
def test_a_line_quality_is_parsed(text: str, expected: LineQuality) -> None:
    assert parse_line_quality(text) == expected


@pytest.mark.parametrize(
    "text", ["rain", "loss", "loss=", "loss=2", "loss=-0.1", "loss=nan", "late=x:1", "batch=-1", "loss=0.1:3"]
)
def test_an_invalid_line_quality_is_rejected(text: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        parse_line_quality(text)
    assert caught.value.key in ("sim.line_quality_word", "sim.line_quality_number")
    assert caught.value.params["found"] == text


def test_the_rejection_of_a_line_quality_names_the_found_and_expected_text() -> None:
    with pytest.raises(ConfigurationError) as caught:
        parse_line_quality("loss=2")
    assert str(caught.value) == "line quality loss=2: expected a number 0 … 1, as in loss=0.05 or late=0.1:0.4"
