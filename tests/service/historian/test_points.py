"""Rollups compared with a naive model, and encoding of blocks."""

from __future__ import annotations

import math
from collections import defaultdict

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivebus.service.historian import blocks, points
from drivebus.service.historian.blocks import DamagedBlock
from drivebus.service.historian.compaction import compact_samples
from drivebus.service.historian.points import (
    BAD,
    GOOD,
    RESOLUTIONS,
    UNCERTAIN,
    Points,
    ResolutionLevel,
    coarsest_covering,
    coarsest_sufficient,
    downsample,
    series_json,
    with_gaps,
)
from fixtures.historian import NOON_MS

TIMES = st.integers(-3_600_000, 4 * 3_600_000)
VALUES = st.one_of(st.just(math.nan), st.floats(-1e9, 1e9, allow_subnormal=False))
SAMPLES = st.lists(st.tuples(TIMES, VALUES, st.sampled_from([GOOD, UNCERTAIN, BAD])), max_size=60)
Rows = list[tuple[int, float, int]]


def columns(rows: Rows) -> tuple[list[int], list[float], bytes]:
    return [NOON_MS + row[0] for row in rows], [row[1] for row in rows], bytes([row[2] for row in rows])


def expected_rollup(rows: Rows, width_ms: int) -> dict[int, tuple[list[float], set[int]]]:
    """Return for each bucket its start → values that count, and the qualities in it."""
    found: dict[int, tuple[list[float], set[int]]] = defaultdict(lambda: ([], set()))
    for time, value, quality in rows:
        values, qualities = found[(NOON_MS + time) // width_ms * width_ms]
        qualities.add(quality)
        if quality != BAD and not math.isnan(value):
            values.append(value)
    return found


def check(rolled: Points, rows: Rows, width_ms: int) -> None:
    expected = expected_rollup(rows, width_ms)
    assert list(rolled.time) == sorted(expected)
    for time, count, low, mean, high, quality in zip(*rolled.columns(), strict=True):
        values, qualities = expected[time]
        assert count == len(values)
        if not values:
            assert math.isnan(low) and math.isnan(mean) and math.isnan(high)
        else:
            assert (low, high) == (min(values), max(values))
            assert low <= mean <= high
            assert mean == pytest.approx(math.fsum(values) / len(values), rel=1e-6, abs=1e-3)
        assert quality == (next(iter(qualities)) if len(qualities) == 1 else UNCERTAIN)


@given(SAMPLES, st.sampled_from([1000, 60_000, 3_600_000]))
def test_a_rollup_equals_the_naive_model(rows: Rows, width_ms: int) -> None:
    check(points.roll_up(points.points_of_samples(*columns(rows)), width_ms), rows, width_ms)


@given(SAMPLES, SAMPLES)
def test_rolling_up_in_steps_and_in_parts_gives_the_same_result(first: Rows, second: Rows) -> None:
    """Two compactions by second, then by minute, concatenated, equal all samples at once, late ones included."""
    parts = [
        points.roll_up(points.roll_up(points.points_of_samples(*columns(part)), 1000), 60_000)
        for part in (first, second)
    ]
    check(points.roll_up(points.concat(parts), 60_000), first + second, 60_000)


@given(SAMPLES)
@settings(max_examples=50)
def test_compacted_blocks_contain_every_sample_and_rollup(rows: Rows) -> None:
    made = compact_samples(7, 100, columns(rows), lambda level, tag, start: None)
    raw = [block for block in made.blocks if block.level is ResolutionLevel.RAW]
    numbers = [block.number for block in raw]
    assert numbers == sorted(numbers)
    decoded = [blocks.decode_samples(block.data) for block in raw]
    assert [time for column in decoded for time in column[0]] == columns(rows)[0]
    assert repr([value for column in decoded for value in column[1]]) == repr(columns(rows)[1])
    assert b"".join(column[2] for column in decoded) == columns(rows)[2]
    for fine in (ResolutionLevel.SECOND, ResolutionLevel.MINUTE, ResolutionLevel.HOUR):
        resolution = RESOLUTIONS[fine]
        level_blocks = [block for block in made.blocks if block.level is fine]
        assert all(block.number == (0 if resolution.merged else 100) for block in level_blocks)
        found = [blocks.decode_points(block.data) for block in level_blocks]
        check(points.concat(found), rows, resolution.width_ms)


def test_a_steady_signal_takes_a_few_bytes_a_sample() -> None:
    time = [NOON_MS + 1000 * n for n in range(3600)]
    value = [25.0 + (n % 7) / 100 for n in range(3600)]
    data = blocks.encode_samples(time, value, bytes(3600))
    assert len(data) < 2400
    assert blocks.decode_samples(data) == (time, value, bytes(3600))


@given(SAMPLES)
@settings(max_examples=30)
def test_a_batch_is_decoded_as_encoded(rows: Rows) -> None:
    groups = [(3, 10, columns(rows)), (4, 0, columns(rows[:3]))]
    assert repr(blocks.decode_batch(blocks.encode_batch(groups))) == repr(groups)


def test_damaged_bytes_are_reported() -> None:
    """The checksum of deflate detects a changed byte, unless it changes nothing, and every missing one."""
    time, value = [NOON_MS + n for n in range(50)], [float(n) for n in range(50)]
    good = blocks.encode_samples(time, value, bytes(50))
    damaged = 0
    for at in range(len(good)):
        flipped = good[:at] + bytes([good[at] ^ 0x10]) + good[at + 1 :]
        try:
            assert blocks.decode_samples(flipped) == (time, value, bytes(50))
        except DamagedBlock:
            damaged += 1
        with pytest.raises(DamagedBlock):
            blocks.decode_samples(good[:at])
    assert damaged >= len(good) - 1
    with pytest.raises(DamagedBlock):
        blocks.decode_points(good)
    batch = blocks.encode_batch([(1, 0, (time, value, bytes(50)))])
    for at in range(len(batch)):
        with pytest.raises(DamagedBlock):
            blocks.decode_batch(batch[:at])


@given(SAMPLES, st.integers(2, 40), st.integers(1, 5 * 3_600_000))
def test_a_trend_keeps_the_extremes_within_its_points(rows: Rows, most: int, span_ms: int) -> None:
    inside = [row for row in rows if 0 <= row[0] <= span_ms]
    found = downsample(
        points.points_of_samples(*columns(inside)), ResolutionLevel.RAW, NOON_MS, NOON_MS + span_ms, most
    )
    assert len(found) <= most
    assert list(found.time) == sorted(set(found.time)) or len(inside) <= most
    values = [row[1] for row in inside if row[2] != BAD and not math.isnan(row[1])]
    shown = series_json(found)
    assert min((value for value in shown["min"] if value is not None), default=None) == min(values, default=None)
    assert max((value for value in shown["max"] if value is not None), default=None) == max(values, default=None)
    assert sum(found.count) == len(values)


def test_a_long_distance_between_samples_becomes_a_gap() -> None:
    time = [NOON_MS + 1000 * n for n in [0, 1, 2, 3, 40, 41, 44]]
    found = series_json(with_gaps(points.points_of_samples(time, [1.0] * 7, bytes(7)), 1))
    assert [moment - NOON_MS for moment in found["t"]] == [0, 1000, 2000, 3000, 4000, 40_000, 41_000, 44_000]
    assert found["mean"] == [1.0, 1.0, 1.0, 1.0, None, 1.0, 1.0, 1.0]
    assert found["q"][4] == BAD


def test_a_stretch_of_slower_polls_has_no_gaps() -> None:
    """Ten samples every 10 s, then many every 1 s: only the minute without samples is a gap."""
    time = [NOON_MS + 10_000 * n for n in range(10)] + [NOON_MS + 150_000 + 1000 * n for n in range(30)]
    found = with_gaps(points.points_of_samples(time, [1.0] * 40, bytes(40)), 1000)
    assert [at - NOON_MS for at, count in zip(found.time, found.count, strict=True) if count == 0] == [91_000]


def test_a_slow_signal_has_no_gaps() -> None:
    time = [NOON_MS + 10_000 * n for n in range(5)]
    assert len(with_gaps(points.points_of_samples(time, [1.0] * 5, bytes(5)), 1000)) == 5


HOUR, DAY = 3_600_000, 86_400_000


@pytest.mark.parametrize(
    ("span_ms", "expected"),
    [
        (60_000, ResolutionLevel.RAW),
        (249_999, ResolutionLevel.RAW),
        (250_000, ResolutionLevel.SECOND),
        (15_000_000 - 1, ResolutionLevel.SECOND),
        (15_000_000, ResolutionLevel.MINUTE),
        (900_000_000 - 1, ResolutionLevel.MINUTE),
        (900_000_000, ResolutionLevel.HOUR),
        (9_000 * DAY, ResolutionLevel.HOUR),
    ],
)
def test_the_coarsest_level_with_enough_points_is_chosen(span_ms: int, expected: ResolutionLevel) -> None:
    assert coarsest_sufficient(NOON_MS, NOON_MS + span_ms, 1000) is expected


@pytest.mark.parametrize(
    ("begins", "expected"),
    [
        ({}, ResolutionLevel.RAW),
        ({ResolutionLevel.RAW: 0}, ResolutionLevel.RAW),
        ({ResolutionLevel.RAW: 100, ResolutionLevel.SECOND: 0}, ResolutionLevel.RAW),
        ({ResolutionLevel.RAW: 101, ResolutionLevel.SECOND: 0}, ResolutionLevel.SECOND),
        ({ResolutionLevel.RAW: 500, ResolutionLevel.SECOND: 450, ResolutionLevel.MINUTE: 0}, ResolutionLevel.MINUTE),
        (
            {
                ResolutionLevel.RAW: 500,
                ResolutionLevel.SECOND: 300,
                ResolutionLevel.MINUTE: 250,
                ResolutionLevel.HOUR: 220,
            },
            ResolutionLevel.SECOND,
        ),
        ({ResolutionLevel.HOUR: 0}, ResolutionLevel.HOUR),
    ],
)
def test_a_coarser_level_is_chosen_where_it_covers_more_time(
    begins: dict[ResolutionLevel, int], expected: ResolutionLevel
) -> None:
    def read(level: ResolutionLevel) -> dict[str, Points]:
        time = [] if level not in begins else [NOON_MS + begins[level] * HOUR, NOON_MS + 999 * HOUR]
        return {"a": points.points_of_samples(time, [1.0] * len(time), bytes(len(time)))}

    chosen, found = coarsest_covering(ResolutionLevel.RAW, NOON_MS, NOON_MS + 1000 * HOUR, read)
    assert (chosen, found) == (expected, read(expected))


def test_a_new_plant_is_shown_at_the_finest_level() -> None:
    """The bucket of an hour begins long before its first sample."""

    def read(level: ResolutionLevel) -> dict[str, Points]:
        begins = {
            ResolutionLevel.RAW: [570_000, 580_000],
            ResolutionLevel.SECOND: [570_000, 580_000],
            ResolutionLevel.MINUTE: [540_000],
        }
        time = begins.get(level, [0])
        return {"a": points.points_of_samples([NOON_MS + at for at in time], [1.0] * len(time), bytes(len(time)))}

    assert coarsest_covering(ResolutionLevel.RAW, NOON_MS, NOON_MS + 600_000, read)[0] is ResolutionLevel.RAW
