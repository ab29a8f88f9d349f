"""Packed columns and blocks: every bit of every value comes back, and damage is reported."""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Callable

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from drivebus.service.historian import blocks, columns
from drivebus.service.historian.columns import ColumnReader, DamagedBlock, pack_floats, pack_integers
from drivebus.service.historian.points import Points, slice_time

QUALITIES = st.sampled_from([0, 1, 2])
DECIMALS = st.integers(0, 7).flatmap(
    lambda places: st.lists(st.integers(-(10**6), 10**6).map(lambda n: n / 10**places), min_size=1, max_size=60)
)
VALUES = st.one_of(st.lists(st.floats(), min_size=1, max_size=60), DECIMALS)
"""Any floats (NaN, infinite, −0, subnormal), or all with at most the same number of decimal places."""
SOME_EXCEPTIONS = st.builds(
    lambda decimals, others: [others.get(n, value) for n, value in enumerate(decimals * 20)],
    DECIMALS,
    st.dictionaries(st.integers(0, 100), st.floats(), max_size=3),
)
JUMPING_TIMES = st.integers(-(2**61), 2**61)


def bits(values: list[float]) -> list[bytes]:
    return [struct.pack("<d", value) for value in values]


@given(st.one_of(VALUES, SOME_EXCEPTIONS))
@example([0.0, -0.0, 0.0])
@example([1.5] * 20 + [-0.0])
@example([1.25] * 20 + [math.nan] + [1.25] * 20)
@example([25.1] * 20 + [math.inf, -math.inf, 1e300, 0.1 + 0.2])
@example([struct.unpack("<d", b"\1\0\0\0\0\0\xf8\x7f")[0]] + [1.0] * 20)
@example([2.0**53, 2.0**53 + 2, -(2.0**62), 2.0**62])
def test_floats_are_restored_bit_by_bit(values: list[float]) -> None:
    packed = pack_floats(values)
    reader = ColumnReader(packed, len(values))
    assert bits(reader.floats()) == bits(values)
    reader.close()


@given(st.lists(JUMPING_TIMES, min_size=1, max_size=60))
@example([5])
@example([0, 127, -1, 126])
@example([7, 7, 7])
@example([0, -300, -600, -900])
@example([2**40, 0, -(2**40)])
@example([0, -128, 0, -129])
@example([0, 2**15 - 1, -1])
@example([0, -(2**31), 0, 2**31 - 1, -1])
def test_integers_are_restored_whatever_their_steps(numbers: list[int]) -> None:
    reader = ColumnReader(pack_integers(numbers), len(numbers))
    assert reader.integers() == numbers
    reader.close()


@pytest.mark.parametrize("numbers", [[2**63], [-(2**63) - 1], [0, 2**63], [-(2**62), 2**62 + 1]])
def test_an_integer_out_of_range_is_refused(numbers: list[int]) -> None:
    with pytest.raises(OverflowError):
        pack_integers(numbers)


@pytest.mark.parametrize(
    ("values", "most"),
    [
        ([25.0 + (n % 7) / 100 for n in range(3600)], 1),
        ([3.0 * n / 10 for n in range(3600)], 1),
        ([25.0] * 1800 + [math.nan] * 10 + [26.01] * 1790, 2.1),
        ([math.pi * n for n in range(3600)], 8),
    ],
    ids=["hundredths", "tenths", "gaps", "no decimals"],
)
def test_decimal_values_take_the_width_of_their_steps(values: list[float], most: float) -> None:
    """A gap, or a value with more places, must not turn an hour of values into floats."""
    assert len(pack_floats(values)) <= most * len(values) + 200


@given(
    st.lists(st.tuples(JUMPING_TIMES, QUALITIES), min_size=1, max_size=60),
    st.one_of(VALUES, SOME_EXCEPTIONS),
)
@settings(max_examples=50)
def test_samples_are_restored_for_any_times_values_and_qualities(
    rows: list[tuple[int, int]], values: list[float]
) -> None:
    n = min(len(rows), len(values))
    time, quality = [row[0] for row in rows[:n]], bytes([row[1] for row in rows[:n]])
    found = blocks.decode_samples(blocks.encode_samples(time, values[:n], quality))
    assert (list(found[0]), bits(list(found[1])), found[2]) == (time, bits(values[:n]), quality)


@given(st.lists(st.tuples(st.floats(), st.floats(), st.floats(), st.integers(0, 2**40)), min_size=1, max_size=30))
@settings(max_examples=50)
def test_rollups_are_restored_bit_by_bit(rows: list[tuple[float, float, float, int]]) -> None:
    low, mean, high = ([row[n] for row in rows] for n in range(3))
    time, quality = [1000 * n for n in range(len(rows))], bytes(n % 3 for n in range(len(rows)))
    points = Points(time=time, count=[row[3] for row in rows], low=low, mean=mean, high=high, quality=quality)
    found = blocks.decode_points(blocks.encode_points(points))
    assert (found.time, found.count, found.quality) == (time, points.count, quality)
    assert [bits(list(column)) for column in (found.low, found.mean, found.high)] == [*map(bits, (low, mean, high))]


@given(
    VALUES | SOME_EXCEPTIONS,
    st.lists(JUMPING_TIMES, min_size=400, max_size=400).map(sorted) | st.just(list(range(0, 4000, 10))),
    st.integers(0, 400),
    st.integers(0, 400),
    st.booleans(),
)
@example([1.25] * 20 + [math.nan] + [1.25] * 20, list(range(0, 4000, 10)), 15, 30, False)
@example([1.25, math.nan], list(range(0, 4000, 10)), 1, 0, False)
def test_part_of_a_rollup_equals_the_whole_one_cut(
    values: list[float], times: list[int], first: int, last: int, flat: bool
) -> None:
    """A value that is stored exactly must not move to another time when only a part of its block is decoded."""
    values = values[: len(times)]
    n = len(values)
    low = values if flat else values[::-1]
    counts = [(7 * place) % 5 for place in range(n)]
    whole = Points(
        time=times[:n], count=counts, low=low, mean=values, high=values, quality=bytes(index % 3 for index in range(n))
    )
    data = blocks.encode_points(whole)
    expected, found = (
        slice_time(whole, times[first % n], times[last % n]),
        blocks.decode_points(data, times[first % n], times[last % n]),
    )
    assert (found.time, found.count, found.quality) == (expected.time, expected.count, expected.quality)
    for column in ("low", "mean", "high"):
        assert bits(getattr(found, column)) == bits(getattr(expected, column))


def test_a_rollup_whose_zeros_differ_in_sign_is_not_flat() -> None:
    """−0.0 equals 0.0, but a row stores what was rolled up."""
    points = Points(time=[0], count=[1], low=[-0.0], mean=[0.0], high=[0.0], quality=b"\0")
    assert bits(list(blocks.decode_points(blocks.encode_points(points)).low)) == bits([-0.0])


TIMES = pack_integers([10, 20, 40])
FLOATS = pack_floats([1.5, 2.5, 0.5])
EXACT = pack_floats([math.pi, math.e, 0.1 + 0.2])


@pytest.mark.parametrize("column", [TIMES, FLOATS, EXACT], ids=["integers", "scaled", "exact"])
def test_a_column_that_ends_early_is_damaged(column: bytes) -> None:
    read: Callable[[ColumnReader], object] = ColumnReader.integers if column is TIMES else ColumnReader.floats
    for size in range(len(column)):
        with pytest.raises(DamagedBlock):
            read(ColumnReader(column[:size], 3))


@pytest.mark.parametrize(
    ("floats", "named"),
    [
        (struct.pack("<bI", 8, 0) + TIMES, "8 decimal places"),
        (struct.pack("<bI", -2, 0) + TIMES, "-2 decimal places"),
        (struct.pack("<bIId", 1, 1, 3, 0.5) + TIMES, "position 3 of 3"),
        (struct.pack("<bI", 1, 0) + TIMES[:8] + b"\3" + TIMES[9:], "steps of 3 bytes"),
        (FLOATS + b"\0", "1 bytes follow"),
    ],
)
def test_values_that_no_encoder_writes_are_damage(floats: bytes, named: str) -> None:
    """The checksum is right here: bytes that were stored wrongly, or by another program."""
    data = struct.pack("<BI", 4, 3) + zlib.compress(TIMES + floats + b"\0\0\0")
    with pytest.raises(DamagedBlock, match=named):
        blocks.decode_samples(data)


@pytest.mark.parametrize(("version", "n"), [(1, 3), (3, 3), (5, 3), (4, 0), (4, 2), (4, 4), (4, 2**32 - 1)])
def test_blocks_of_another_version_or_size_are_damage(version: int, n: int) -> None:
    data = struct.pack("<BI", version, n) + zlib.compress(TIMES + FLOATS + b"\0\0\0")
    with pytest.raises(DamagedBlock):
        blocks.decode_samples(data)


def test_the_largest_reading_fits_the_decimal_places() -> None:
    """A scale rounds to its decimals + 3, at most 7: no reading needs the exact floats."""
    assert columns._MAX_PLACES == 4 + 3
    assert len(pack_floats([round(n * 1.2345678, 7) for n in range(1000)])) < 5 * 1000
