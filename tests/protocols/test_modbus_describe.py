"""Descriptions of Modbus frames by the tolerant reader."""

from __future__ import annotations

import pytest

from drivebus import i18n
from drivebus.protocols.describe import FrameDescription
from drivebus.protocols.modbus import describe
from drivebus.protocols.modbus.rtu import build_frame
from fixtures.vectors import Vector, load_vectors

VECTORS = (*load_vectors("vc660"), *load_vectors("df800"))


def described(vector: Vector, request: bytes | None = None) -> FrameDescription:
    form = "short" if vector.model == "df800" else "exception"
    direction = "request" if vector.direction == "request" else "response"
    return describe(vector.data, vector.encoding, direction, request, form)


def bare(fields: dict[str, object]) -> dict[str, object]:
    """Without what only a profile knows."""
    return {name: value for name, value in fields.items() if name not in ("frequency_hz", "parameter")}


@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: vector.id)
def test_a_vector_is_read_with_its_request_and_without(vector: Vector) -> None:
    asked = vector.request
    for request in (None, asked.data if asked else None):
        found = described(vector, request)
        if vector.line.get("decodable", True):
            assert found.valid
            assert found.fields | bare(vector.fields) == found.fields
            assert found.canonical == vector.data
        else:
            assert not found.valid
            assert [key for key, _ in found.problems] == ["modbus.crc"]
            assert found.fields["registers"] == [0xC388, 2, 5000, 0]


def test_a_read_reply_without_its_request_reports_what_is_missing() -> None:
    found = describe(bytes.fromhex("01 03 06 13 88 0F 9E 00 80 A0 93"), "rtu", "response")
    assert [(reading.note[0], reading.fields) for reading in found.interpretations] == [
        ("modbus.reading.registers", {"function": 3, "count": 3})
    ]


def test_a_write_reply_is_its_request_or_an_echo() -> None:
    found = describe(bytes.fromhex("01 06 20 00 00 01 43 CA"), "rtu", "response")
    assert [reading.note[0] for reading in found.interpretations] == ["modbus.reading.echo"]


def test_a_short_error_may_be_the_beginning_of_an_echo() -> None:
    found = describe(bytes.fromhex("01 06 00 23 A0"), "rtu", "response", None, "short")
    assert found.fields == {"address": 1, "function": 6, "error": True}
    assert found.interpretations[0].note == ("modbus.reading.cut_echo", {"register": 0x23, "high": 0xA0})


def test_lower_case_digits_are_read_and_called_an_erratum() -> None:
    found = describe(b":010620000002d7\r\n", "ascii", "request")
    assert found.valid
    assert found.errata == (("modbus.lower_case", {}),)
    assert found.canonical == b":010620000002D7\r\n"


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("01 06 20 00 00 01 43", "protocols.length"),
        ("01 06 20 00 00 01 43 CA 00", "protocols.trailing"),
        ("01 06 20 00 00 01 43 CB", "modbus.crc"),
        ("01 03 00 00 00 7E C5 EA", "modbus.count"),
        ("", "protocols.length"),
    ],
)
def test_what_is_wrong_with_a_request_is_named(text: str, key: str) -> None:
    found = describe(bytes.fromhex(text), "rtu", "request")
    assert (found.valid, [each for each, _ in found.problems]) == (False, [key])


@pytest.mark.parametrize(
    ("text", "direction"),
    [
        ("01 03 08 C3 88 00 02 13 88 00 00 21 A8", "response"),
        ("01 83 02 00 00", "response"),
        ("01 03 30 01 00 03 00 00", "request"),
        ("01 06 20 00 00 01 43 CA", "request"),
        ("01 06 20 00 00 01 00 00", "request"),
    ],
)
def test_the_shape_decides_the_direction_even_of_a_frame_with_a_bad_check(text: str, direction: str) -> None:
    assert describe(bytes.fromhex(text), "rtu").direction == direction


def test_any_bytes_get_a_description() -> None:
    import random

    rng = random.Random(2)
    for turn in range(3000):
        data = rng.randbytes(rng.randrange(24))
        if turn % 2:
            data = b"\x01" + bytes((rng.choice((1, 3, 5, 6, 8, 15, 16, 0x83)),)) + data
        request = None if turn % 3 else rng.randbytes(8)
        for encoding in ("rtu", "ascii"):
            for direction in ("request", "response"):
                found = describe(data, encoding, direction, request, "short" if turn % 5 else "exception")
                assert found.valid or found.problems


def frame(octets: str) -> bytes:
    return build_frame(bytes.fromhex(octets))


def test_a_spoiled_exception_is_still_a_reply() -> None:
    for octets, function in (("01 83 02", 3), ("01 86 02", 6)):
        found = describe(frame(octets)[:-1] + b"\x00", "rtu")
        assert (found.direction, found.fields) == ("response", {"address": 1, "function": function, "exception": 2})


def test_five_bytes_are_a_short_error_only_with_00_and_a_good_check() -> None:
    assert describe(frame("01 06 00"), "rtu", "response", None, "short").valid
    for data in (frame("01 06 01"), frame("01 06 00")[:-1] + b"\x00"):
        found = describe(data, "rtu", "response", None, "short")
        assert found.problems == (("protocols.length", {"expected": 8, "found": 5}),)
    assert not describe(frame("01 06 00"), "rtu", "response").valid


def test_only_registers_have_an_even_count_of_octets() -> None:
    for octets, key in (
        ("01 01 01 05", None),
        ("01 01 02 05 06", None),
        ("01 03 02 00 05", None),
        ("01 03 03 00 05 06", "modbus.odd_byte_count"),
        ("01 04 01 00 00", "modbus.odd_byte_count"),
        ("01 03 00 00", "modbus.byte_count"),
    ):
        found = describe(frame(octets), "rtu", "response")
        assert [name for name, _ in found.problems] == ([key] if key else []), octets


@pytest.mark.parametrize(
    ("octets", "words"),
    [
        ("01 03 FF 00", "byte count 255 received, an even number expected: each register has two bytes"),
        ("01 04 00", "byte count 0 received, 2 expected"),
        ("01 01 00", "byte count 0 received, 1 expected"),
    ],
)
def test_a_wrong_byte_count_is_not_answered_with_one_that_no_reply_can_have(octets: str, words: str) -> None:
    """Of 255 the sentence expected 256, which one byte can't hold, and of 0 one byte of a register."""
    ((key, params),) = describe(frame(octets), "rtu", "response").problems
    assert i18n.text(key, "en", **params) == words


def test_a_request_has_no_exception_whatever_its_function() -> None:
    found = describe(frame("01 83 00 01 00 02"), "rtu", "request")
    assert found.fields == {"address": 1, "function": 0x83, "register": 1, "count": 2}


def test_bytes_of_rtu_are_no_digits_in_any_case() -> None:
    assert describe(frame("61 03 00 01 00 02"), "rtu", "request").errata == ()


def test_what_a_reply_may_answer_is_decided_by_its_size() -> None:
    (bits,) = describe(frame("01 01 01 05"), "rtu", "response").interpretations
    assert (bits.note[1], bits.fields) == ({"count": 8}, {"function": 1, "count": 8})
    (echo,) = describe(frame("01 10 00 01 00 02"), "rtu", "response").interpretations
    assert (echo.note[0], echo.fields) == ("modbus.reading.echo", {})
    (echo,) = describe(frame("01 08 00 00 00 02"), "rtu", "response").interpretations
    assert echo.fields == {"address": 1, "function": 8, "sub_function": 0, "data": 2}
    (echo,) = describe(frame("01 05 00 01 FF 00"), "rtu", "response").interpretations
    assert echo.fields == {"address": 1, "function": 5, "register": 1, "value": 0xFF00}


def test_an_ascii_short_error_is_no_beginning_of_an_echo() -> None:
    """The short error has CR LF where the echo has digits."""
    found = describe(b":010600F9\r\n", "ascii", "response", None, "short")
    assert found.valid and found.interpretations == ()
