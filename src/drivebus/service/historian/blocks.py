"""Binary encoding of stored rows: columns, packed and deflated, little-endian. ``columns`` describes packed columns.

A block of raw samples: ``<BI`` version 4, n; deflated: packed times (UTC ms), packed values (NaN: a gap), n × uint8
qualities.
A block of a rollup: ``<BI`` 5, n; deflated: packed times (UTC ms), packed counts, n × uint8 qualities, packed means,
lows and highs. If low = mean = high in all points: version 6, without lows and highs.
Versions 1 to 3 are in tables of version 1, which ``HistoryStore.open`` refuses.
"""

from __future__ import annotations

import struct
import zlib
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence

from drivebus.service.historian.columns import (
    ColumnReader,
    DamagedBlock,
    pack,
    pack_floats,
    pack_integers,
    unpack,
    unpack_floats,
)
from drivebus.service.historian.points import Points

_BLOCK_HEADER = struct.Struct("<BI")
_RAW, _ROLLED, _FLAT = 4, 5, 6
_DEFLATE_LEVEL = 1
"""A higher level saves a hundredth and takes a fifth more time (values with two decimals, 3,600 a block)."""

SampleColumns = tuple[Sequence[int], Sequence[float], bytes]
"""Times (UTC ms), values (NaN: a gap), quality codes; in order of arrival."""


def encode_samples(time: Sequence[int], value: Sequence[float], quality: bytes) -> bytes:
    return _pack_block(_RAW, len(time), pack_integers(time) + pack_floats(value) + quality)


def decode_samples(data: bytes) -> SampleColumns:
    """Decode samples. Raises DamagedBlock."""
    _, _, columns = _unpack_block(data, {_RAW})
    samples = columns.integers(), columns.floats(), columns.octets()
    columns.close()
    return samples


def encode_points(points: Points) -> bytes:
    body = pack_integers(points.time) + pack_integers(points.count) + points.quality + pack_floats(points.mean)
    if _is_flat(points):
        return _pack_block(_FLAT, len(points), body)
    return _pack_block(_ROLLED, len(points), body + pack_floats(points.low) + pack_floats(points.high))


def _is_flat(points: Points) -> bool:
    """Return whether low, mean and high are the same, bit by bit."""
    if points.low is points.mean is points.high:
        return True
    low, mean, high = (pack("d", column) for column in (points.low, points.mean, points.high))
    return low == mean == high


def decode_points(data: bytes, first_ms: int | None = None, last_ms: int | None = None) -> Points:
    """Decode points, only those with ``first_ms <= time <= last_ms`` where given. Raises DamagedBlock."""
    kind, n, columns = _unpack_block(data, {_ROLLED, _FLAT})
    time = columns.integers()
    begin = 0 if first_ms is None else bisect_left(time, first_ms)
    end = n if last_ms is None else bisect_right(time, last_ms)
    columns.wanted = slice(begin, max(begin, end))
    count, quality, mean = columns.integers(), columns.octets(), columns.floats()
    low, high = (mean, mean) if kind == _FLAT else (columns.floats(), columns.floats())
    columns.close()
    return Points(time=time[columns.wanted], count=count, low=low, mean=mean, high=high, quality=quality)


def _pack_block(kind: int, n: int, body: bytes) -> bytes:
    return _BLOCK_HEADER.pack(kind, n) + zlib.compress(body, _DEFLATE_LEVEL)


def _unpack_block(data: bytes, kinds: set[int]) -> tuple[int, int, ColumnReader]:
    """Return kind, number of points and columns of a block of one of these kinds."""
    try:
        kind, n = _BLOCK_HEADER.unpack_from(data)
        body = zlib.decompress(data[_BLOCK_HEADER.size :])
    except (struct.error, zlib.error) as error:
        raise DamagedBlock(str(error)) from error
    if n == 0 or kind not in kinds:
        raise DamagedBlock(f"kind {kind} with {n} points")
    return kind, n, ColumnReader(body, n)


_BATCH_GROUP = struct.Struct("<qqq")


def encode_batch(groups: Iterable[tuple[int, int, SampleColumns]]) -> bytes:
    """Encode the samples of one flush interval, ``(tag, number of the first, samples)``, as a row of the journal."""
    rows = list(groups)
    heads = b"".join(_BATCH_GROUP.pack(tag, first, len(samples[0])) for tag, first, samples in rows)
    bodies = b"".join(pack("q", time) + pack("d", value) + quality for _, _, (time, value, quality) in rows)
    return struct.pack("<I", len(rows)) + heads + bodies


def decode_batch(data: bytes) -> list[tuple[int, int, SampleColumns]]:
    """Decode a row of the journal. Raises DamagedBlock."""
    try:
        (rows,) = struct.unpack_from("<I", data)
        heads = [_BATCH_GROUP.unpack_from(data, 4 + _BATCH_GROUP.size * n) for n in range(rows)]
    except struct.error as error:
        raise DamagedBlock(str(error)) from error
    at = 4 + _BATCH_GROUP.size * rows
    if at + 17 * sum(n for _, _, n in heads) != len(data):
        raise DamagedBlock(f"{len(data)} bytes for {rows} groups")
    columns: list[tuple[int, int, SampleColumns]] = []
    for tag, first, n in heads:
        values, qualities, end = at + 8 * n, at + 16 * n, at + 17 * n
        samples = unpack("q", data[at:values]), unpack_floats(data[values:qualities]), data[qualities:end]
        columns.append((tag, first, samples))
        at = end
    return columns
