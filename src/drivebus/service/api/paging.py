"""Pages of a list that grows at its head, and opaque cursors: a few whole numbers as text."""

from __future__ import annotations

from base64 import urlsafe_b64decode, urlsafe_b64encode
from collections.abc import Callable, Iterable

from drivebus.errors import InvalidParameters
from drivebus.service.api.errors import param_fault
from drivebus.types import Json

MAX_CURSOR_NUMBER = 2**63 - 1  # largest integer that a database takes


def page(items: Iterable[tuple[int, Callable[[], Json]]], cursor: str | None, limit: int) -> Json:
    """Return ``{"items", "next"}``; ``items`` come newest (largest number) first. Raises InvalidParameters."""
    below = page_start(cursor)
    rows: list[Json] = []
    last = 0
    for number, make in items:
        if below is not None and number >= below:
            continue
        if len(rows) == limit:
            return {"items": rows, "next": encode_cursor(last)}
        rows.append(make())
        last = number
    return {"items": rows, "next": None}


def page_start(cursor: str | None) -> int | None:
    """Return the number below which a page begins; None for the first page. Raises InvalidParameters."""
    return None if cursor is None else decode_cursor(cursor, 1)[0]


def encode_cursor(*numbers: int) -> str:
    """Return the cursor of a place in a list."""
    return urlsafe_b64encode(".".join(map(str, numbers)).encode()).decode()


def decode_cursor(text: str, count: int) -> list[int]:
    """Return the ``count`` numbers of a cursor. Raises InvalidParameters."""
    try:
        numbers = [int(part) for part in urlsafe_b64decode(text.encode()).decode().split(".")]
        in_range = min(numbers) >= 0 and max(numbers) <= MAX_CURSOR_NUMBER
        if len(numbers) == count and in_range and encode_cursor(*numbers) == text:
            return numbers
    except ValueError:
        pass
    raise InvalidParameters("plant.params", faults=[param_fault("cursor", text[:60], "cursor")])
