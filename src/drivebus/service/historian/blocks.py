"""Binary encoding of stored rows: columns, packed and deflated, little-endian.

A block of raw samples: ``<BI`` version 1, n; deflated: n × int32 time steps in ms (the first from the partition's
start; negative where the clock was set back), n × float64 values (NaN: a gap), n × uint8 qualities.
A block of a rollup: ``<BI`` 2, n; deflated: n × uint32 point numbers in the partition, n × uint32 counts, n × uint8
qualities, n × float64 mean, low, high. If low = mean = high in all points: version 3, without low and high.
"""

from __future__ import annotations

import struct
import sys
import zlib
from array import array
from collections.abc import Iterable, Sequence
from itertools import accumulate
from operator import sub

from drivebus.service.historian.points import Points

_BLOCK_HEADER = struct.Struct("<BI")
_RAW, _ROLLED, _FLAT = 1, 2, 3
_DEFLATE_LEVEL = 1
"""A higher level saves a tenth and takes twice the time (values with two decimals, 1,700 a block)."""

SampleColumns = tuple[list[int], list[float], bytes]
"""Times (UTC ms), values (NaN: a gap), quality codes; in order of arrival."""


class DamagedBlock(ValueError):
    """The bytes of a row are not a valid block."""


def pack(code: str, numbers: Iterable[float]) -> bytes:
    """Return numbers of one ``array`` type code as little-endian bytes."""
    found = array(code, numbers)
    if sys.byteorder == "big":
        found.byteswap()
    return bytes(found.tobytes())


def unpack(code: str, data: bytes) -> list[int]:
    found = array(code)
    found.frombytes(data)
    if sys.byteorder == "big":
        found.byteswap()
    return found.tolist()


def unpack_floats(data: bytes) -> list[float]:
    return unpack("d", data)  # type: ignore[return-value]


def encode_samples(start_ms: int, time: Sequence[int], value: Sequence[float], quality: bytes) -> bytes:
    """Encode samples of the partition that starts at ``start_ms``."""
    steps = map(sub, time, [start_ms, *time[:-1]])
    body = pack("i", steps) + pack("d", value) + quality
    return _BLOCK_HEADER.pack(_RAW, len(time)) + zlib.compress(body, _DEFLATE_LEVEL)


def decode_samples(start_ms: int, data: bytes) -> SampleColumns:
    """Decode samples. Raises DamagedBlock."""
    _, n, body = _unpack_block(data, {_RAW: 13})
    time = list(accumulate(unpack("i", body[: 4 * n]), initial=start_ms))[1:]
    return time, unpack_floats(body[4 * n : 12 * n]), body[12 * n :]


def encode_points(start_ms: int, width_ms: int, points: Points) -> bytes:
    """Encode points of ``width_ms`` of the partition that starts at ``start_ms``."""
    places = pack("I", [(time - start_ms) // width_ms for time in points.time])
    low, mean, high = (pack("d", column) for column in (points.low, points.mean, points.high))
    flat = low == mean == high
    body = places + pack("I", points.count) + points.quality + mean + (b"" if flat else low + high)
    return _BLOCK_HEADER.pack(_FLAT if flat else _ROLLED, len(points)) + zlib.compress(body, _DEFLATE_LEVEL)


def decode_points(start_ms: int, width_ms: int, data: bytes) -> Points:
    """Decode points. Raises DamagedBlock."""
    kind, n, body = _unpack_block(data, {_ROLLED: 33, _FLAT: 17})
    time = _point_times(start_ms, width_ms, unpack("I", body[: 4 * n]))
    mean = unpack_floats(body[9 * n : 17 * n])
    low, high = (mean, mean) if kind == _FLAT else (unpack_floats(body[17 * n : 25 * n]), unpack_floats(body[25 * n :]))
    return Points(
        time=time, count=unpack("I", body[4 * n : 8 * n]), low=low, mean=mean, high=high, quality=body[8 * n : 9 * n]
    )


def _point_times(start_ms: int, width_ms: int, places: list[int]) -> list[int]:
    first, last = places[0], places[-1]
    if last - first == len(places) - 1:
        return list(range(start_ms + first * width_ms, start_ms + last * width_ms + 1, width_ms))
    return [start_ms + place * width_ms for place in places]


def _unpack_block(data: bytes, sizes: dict[int, int]) -> tuple[int, int, bytes]:
    """Return kind, number of points and inflated bytes. ``sizes``: bytes a point of the allowed kinds."""
    try:
        kind, n = _BLOCK_HEADER.unpack_from(data)
        body = zlib.decompress(data[_BLOCK_HEADER.size :])
    except (struct.error, zlib.error) as error:
        raise DamagedBlock(str(error)) from error
    if n == 0 or sizes.get(kind, -1) * n != len(body):
        raise DamagedBlock(f"kind {kind}: {len(body)} bytes for {n} points")
    return kind, n, body


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
    found = []
    for tag, first, n in heads:
        values, qualities, end = at + 8 * n, at + 16 * n, at + 17 * n
        samples = unpack("q", data[at:values]), unpack_floats(data[values:qualities]), data[qualities:end]
        found.append((tag, first, samples))
        at = end
    return found
