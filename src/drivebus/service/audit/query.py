"""Query of the audit trail: pages of records, newest first."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from drivebus.service.api.paging import page, page_start
from drivebus.service.audit import records
from drivebus.service.audit.chain import AuditPaths, first_number_of, lines_backwards
from drivebus.types import Json


def query_records(
    paths: AuditPaths, *, from_ms: int, to_ms: int, drive: str | None, cursor: str | None, limit: int
) -> Json:
    """Return a page of the records in ``from_ms <= time < to_ms``, about ``drive`` if given, newest first.

    Lines with a wrong hash are left out; ``verify`` reports them. Raises InvalidParameters, OSError.
    """

    def is_wanted(body: Json) -> bool:
        return from_ms <= body["time_ms"] < to_ms and (drive is None or drive in subjects_of(body))

    return page(_matching(paths, page_start(cursor), is_wanted), cursor, limit)


def subjects_of(body: Json) -> tuple[Any, ...]:
    """Return the subjects of a record: its target and the other drives that it affected."""
    drives = body.get("params", {}).get("drives", ())
    return (body.get("target"), *(drives if isinstance(drives, list) else ()))


def _matching(
    paths: AuditPaths, below: int | None, matches: Callable[[Json], bool]
) -> Iterator[tuple[int, Callable[[], Json]]]:
    for line in _lines(paths, below):
        record = records.decode_record(line)
        if record is not None and matches(record.body):
            item = {"n": record.n, **record.body, "hash": record.hash}
            yield record.n, lambda item=item: item  # type: ignore[misc]


def _lines(paths: AuditPaths, below: int | None) -> Iterator[bytes]:
    """Yield lines from the end. Files and lines of earlier pages are skipped without parsing."""
    for path in reversed(paths.files()):
        first = first_number_of(path)
        if below is None or first is None or first < below:
            yield from (line for line in lines_backwards(path) if below is None or _record_number(line) < below)


def _record_number(line: bytes) -> int:
    """Return the number of a line ``{"n":123,…`` without parsing it; 0 for anything else."""
    text = line[5 : line.find(b",")]
    return int(text) if line.startswith(b'{"n":') and text.isdigit() else 0
