"""Parquet encoding, part by part. The only module that imports pyarrow."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import pyarrow as pa  # type: ignore[import-untyped]
import pyarrow.parquet as pq  # type: ignore[import-untyped]

PARQUET_ROWS_PER_GROUP = 100_000
"""Rows of one row group, which is one part: about 1 MB."""

_COLUMN_TYPES = {
    "time": pa.timestamp("ms", tz="UTC"),
    "tag": pa.dictionary(pa.int32(), pa.string()),
    "unit": pa.dictionary(pa.int32(), pa.string()),
    "quality": pa.dictionary(pa.int32(), pa.string()),
    "number": pa.int64(),
    "values": pa.int64(),
}


class _CountingSink(io.RawIOBase):
    """Output stream that counts all bytes, for the file's offsets, and holds those not taken yet."""

    def __init__(self) -> None:
        self._pending = bytearray()
        self._count = 0

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        size = memoryview(data).nbytes
        self._pending += data
        self._count += size
        return size

    def tell(self) -> int:
        return self._count

    def take(self) -> bytes:
        data, self._pending = self._pending, bytearray()
        return bytes(data)


def parquet_parts(windows: Iterable[list[tuple[Any, ...]]], names: Sequence[str]) -> Iterator[bytes]:
    """Yield the parts of a Parquet file; concatenated they are the file."""
    schema = pa.schema([(name, _COLUMN_TYPES.get(name, pa.float64())) for name in names])
    sink = _CountingSink()
    with pq.ParquetWriter(sink, schema, compression="zstd") as writer:
        for rows in windows:
            for at in range(0, len(rows), PARQUET_ROWS_PER_GROUP):
                columns = zip(*rows[at : at + PARQUET_ROWS_PER_GROUP], strict=True)
                arrays = [pa.array(column, field.type) for column, field in zip(columns, schema, strict=True)]
                writer.write_table(pa.table(arrays, schema=schema))
                yield sink.take()
    yield sink.take()
