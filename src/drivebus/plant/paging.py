"""Pages of a list that grows at its head: an opaque cursor, which is the number of the last item that was given."""

from __future__ import annotations

from base64 import urlsafe_b64decode, urlsafe_b64encode
from collections.abc import Callable, Iterable

from drivebus.errors import ParamsError
from drivebus.plant.params import fault
from drivebus.plant.view import Json


def page(items: Iterable[tuple[int, Callable[[], Json]]], cursor: str | None, limit: int) -> Json:
    """``{"items", "next"}``: items come newest (largest number) first. Raises ParamsError."""
    below = after(cursor)
    found: list[Json] = []
    last = 0
    for number, made in items:
        if below is not None and number >= below:
            continue
        if len(found) == limit:
            return {"items": found, "next": _cursor(last)}
        found.append(made())
        last = number
    return {"items": found, "next": None}


def after(cursor: str | None) -> int | None:
    """The number that the next page goes on below; None: from the newest. Raises ParamsError."""
    if cursor is None:
        return None
    try:
        text = urlsafe_b64decode(cursor.encode()).decode()
        if text.isdecimal() and _cursor(int(text)) == cursor:
            return int(text)
    except ValueError:
        pass
    raise ParamsError("plant.params", faults=[fault("cursor", cursor[:60], "cursor")])


def _cursor(number: int) -> str:
    return urlsafe_b64encode(str(number).encode()).decode()
