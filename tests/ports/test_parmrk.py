"""Decoding of parity line_errors: each line error is counted and a good FF stays, wherever the chunks end."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from drivebus.ports.parmrk import ParityMarkDecoder


def encoded(line: list[tuple[int, bool]]) -> bytes:
    """Return the bytes that a kernel writes for (byte, bad) pairs."""
    out = bytearray()
    for byte, bad in line:
        out += bytes((0xFF, 0, byte)) if bad else b"\xff\xff" if byte == 0xFF else bytes((byte,))
    return bytes(out)


def decoded(chunks: list[bytes]) -> tuple[bytes, int]:
    decoder, data, line_errors = ParityMarkDecoder(), b"", 0
    for chunk in chunks:
        more, bad = decoder.decode(chunk)
        data, line_errors = data + more, line_errors + bad
    return data, line_errors


@given(st.lists(st.tuples(st.sampled_from([0, 1, 0x41, 0xFE, 0xFF]), st.booleans())), st.data())
def test_line_errors_are_counted_and_ff_survives_at_every_split(
    line: list[tuple[int, bool]], data: st.DataObject
) -> None:
    raw = encoded(line)
    expected = bytes(byte for byte, _ in line), sum(bad for _, bad in line)
    cut = data.draw(st.integers(0, len(raw)))
    assert decoded([raw]) == expected
    assert decoded([raw[:cut], raw[cut:]]) == expected
    assert decoded([raw[i : i + 1] for i in range(len(raw))]) == expected


def test_a_break_is_a_line_error_on_a_zero_byte() -> None:
    assert decoded([b"\xff\x00\x00"]) == (b"\x00", 1)


def test_an_invalid_escape_is_a_line_error() -> None:
    assert decoded([b"\xff\x41"]) == (b"\xff\x41", 1)


def test_an_unfinished_escape_is_discarded_when_the_port_is_reopened() -> None:
    decoder = ParityMarkDecoder()
    assert decoder.decode(b"a\xff\x00") == (b"a", 0)
    decoder.reset()
    assert decoder.decode(b"b") == (b"b", 0)
