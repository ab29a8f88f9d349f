"""Pages of a list that grows at its head: an opaque cursor, which is the number of the last item that was given."""

from __future__ import annotations

from base64 import urlsafe_b64decode, urlsafe_b64encode
from collections.abc import Callable, Iterable

from drivebus.errors import InvalidParameters
from drivebus.service.api.param_errors import param_fault
from drivebus.service.live.views import Json


def page(items: Iterable[tuple[int, Callable[[], Json]]], cursor: str | None, limit: int) -> Json:
    """``{"items", "next"}``: items come newest (largest number) first. Raises InvalidParameters."""
    below = decode_cursor(cursor)
    found: list[Json] = []
    last = 0
    for number, made in items:
        if below is not None and number >= below:
            continue
        if len(found) == limit:
            return {"items": found, "next": encode_cursor(last)}
        found.append(made())
        last = number
    return {"items": found, "next": None}


def decode_cursor(cursor: str | None) -> int | None:
    """The number that the next page goes on below; None: from the newest. Raises InvalidParameters."""
    if cursor is None:
        return None
    try:
        text = urlsafe_b64decode(cursor.encode()).decode()
        if text.isdecimal() and encode_cursor(int(text)) == cursor:
            return int(text)
    except ValueError:
        pass
    raise InvalidParameters("plant.params", faults=[param_fault("cursor", cursor[:60], "cursor")])


def encode_cursor(number: int) -> str:
    return urlsafe_b64encode(str(number).encode()).decode()
