"""Checksums against their published check values and fastcrc; digit tables against every byte."""

from __future__ import annotations

import importlib
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivebus.errors import AlphabetError
from drivebus.protocols import checksum
from peers import need_module


@given(st.binary(max_size=300))
def test_crc16_equals_fastcrc(data: bytes) -> None:
    need_module("fastcrc")
    assert checksum.crc16(data) == importlib.import_module("fastcrc").crc16.modbus(data)


def test_crc16_has_the_check_value_of_its_catalogue() -> None:
    assert checksum.crc16(b"123456789") == 0x4B37


def test_lrc_makes_the_sum_zero() -> None:
    data = bytes.fromhex("01 03 21 02 00 02")
    assert checksum.lrc(data) == 0xD7
    assert (sum(data) + checksum.lrc(data)) & 0xFF == 0


def test_sum16_wraps_at_65536() -> None:
    assert checksum.sum16(b"\xff" * 1000) == 255_000 - 3 * 65536


@given(st.binary(max_size=2000))
def test_sum16_is_the_sum_of_the_bytes_modulo_65536(data: bytes) -> None:
    assert checksum.sum16(data) == sum(data) % 65536


@given(st.integers(1, 8).flatmap(lambda width: st.tuples(st.just(width), st.integers(0, 16**width - 1))))
def test_hex_digits_come_back(case: tuple[int, int]) -> None:
    width, value = case
    digits = checksum.hex_digits(value, width)
    assert len(digits) == width
    assert checksum.hex_value(digits) == value


@given(st.binary(min_size=1, max_size=64))
def test_hex_pairs_come_back(data: bytes) -> None:
    assert checksum.hex_bytes(checksum.hex_pairs(data)) == data


@pytest.mark.parametrize(("value", "width"), [(-1, 2), (256, 2), (65536, 4), (16, 1)])
def test_a_value_that_does_not_fit_is_rejected_not_cut(value: int, width: int) -> None:
    with pytest.raises(ValueError, match="does not fit"):
        checksum.hex_digits(value, width)
    with pytest.raises(ValueError, match="does not fit"):
        checksum.decimal_digits(10**width, width)
    with pytest.raises(ValueError, match="does not fit"):
        checksum.decimal_digits(-1, width)


@pytest.mark.parametrize(
    ("table", "alphabet"),
    [
        (checksum.STRICT_HEX_DIGITS, b"0123456789ABCDEF"),
        (checksum.TOLERANT_HEX_DIGITS, b"0123456789ABCDEFabcdef:;<=>?"),
    ],
)
@pytest.mark.parametrize("position", range(4))
def test_every_byte_in_every_position_is_a_digit_of_the_table_or_an_error(
    table: bytes, alphabet: bytes, position: int
) -> None:
    for byte in range(256):
        digits = bytearray(b"1234")
        digits[position] = byte
        if byte in alphabet:
            assert int(checksum.canonical_digits(bytes(digits), table), 16) < 0x10000
        else:
            with pytest.raises(AlphabetError) as caught:
                checksum.canonical_digits(bytes(digits), table, start=7)
            assert (caught.value.found, caught.value.params["position"]) == (byte, 7 + position)


@pytest.mark.parametrize("text", ["+24D", " 249", "2_4D", "0x24", "24D "])
def test_text_that_python_reads_as_a_number_is_no_number_here(text: str) -> None:
    with pytest.raises(AlphabetError):
        checksum.hex_value(text.encode())


def test_decimal_digits_know_no_letters() -> None:
    assert checksum.decimal_value(b"07") == 7
    with pytest.raises(AlphabetError) as caught:
        checksum.decimal_value(b"0A", start=3)
    assert (caught.value.found, caught.value.expected, caught.value.params["position"]) == (0x41, "0-9", 4)


@pytest.mark.parametrize(("digits", "value"), [(b"3:", 0x3A), (b"24=", 0x24D), (b"?f", 0xFF)])
def test_the_tolerant_table_reads_the_manuals_other_spelling(digits: bytes, value: int) -> None:
    assert int(checksum.canonical_digits(digits, checksum.TOLERANT_HEX_DIGITS), 16) == value


def test_an_alphabet_error_carries_byte_and_position() -> None:
    with pytest.raises(AlphabetError) as caught:
        checksum.hex_value(b"0G", start=3)
    assert str(caught.value) == "byte 4: 47H is not one of the digits 0-9 A-F"
    assert caught.value.text("zh") == "第 4 字节：47H 不是数字字符 0-9 A-F"


READERS = [checksum.canonical_digits, checksum.hex_value, checksum.decimal_value, checksum.hex_bytes]


@pytest.mark.parametrize("reads", READERS, ids=lambda reads: reads.__name__)
def test_positions_count_from_0_unless_given(reads: Callable[[bytes], object]) -> None:
    with pytest.raises(AlphabetError) as caught:
        reads(b"12G4")
    assert caught.value.params["position"] == 2
