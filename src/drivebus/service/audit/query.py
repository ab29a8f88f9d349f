"""The trail from its end, a page at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from drivebus.service.api.paging import decode_cursor, page
from drivebus.service.audit import records
from drivebus.service.audit.chain import AuditPaths, first_number_of, lines_backwards
from drivebus.service.live.views import Json


def query_records(
    places: AuditPaths, from_ms: int, to_ms: int, drive: str | None, cursor: str | None, limit: int
) -> Json:
    """Records from ``from_ms`` up to and without ``to_ms``, about ``drive`` where it is given, the newest first.

    A line whose hash is wrong is left out: ``verify`` tells of it. Raises InvalidParameters, OSError.
    """

    def wanted(body: Json) -> bool:
        return from_ms <= body["time_ms"] < to_ms and (drive is None or drive in subjects_of(body))

    return page(_matching(places, decode_cursor(cursor), wanted), cursor, limit)


def subjects_of(body: Json) -> tuple[Any, ...]:
    """What a record is about: its target, the other drives that it did something to."""
    drives = body.get("params", {}).get("drives", ())
    return (body.get("target"), *(drives if isinstance(drives, list) else ()))


def _matching(
    places: AuditPaths, below: int | None, wanted: Callable[[Json], bool]
) -> Iterator[tuple[int, Callable[[], Json]]]:
    for line in _lines(places, below):
        found = records.decode_record(line)
        if found is not None and wanted(found.body):
            item = {"n": found.n, **found.body, "hash": found.hash}
            yield found.n, lambda item=item: item  # type: ignore[misc]


def _lines(places: AuditPaths, below: int | None) -> Iterator[bytes]:
    """From the end; whole files and lines that are on earlier pages are not looked into."""
    for path in reversed(places.files()):
        first = first_number_of(path)
        if below is None or first is None or first < below:
            yield from (line for line in lines_backwards(path) if below is None or _record_number(line) < below)


def _record_number(line: bytes) -> int:
    """``{"n":123,…``; 0 for what can't be a record: ``seal.record`` says so."""
    text = line[5 : line.find(b",")]
    return int(text) if line.startswith(b'{"n":') and text.isdigit() else 0
