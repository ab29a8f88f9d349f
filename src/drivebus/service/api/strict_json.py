"""``parse_json``: the one parser of requests, from HTTP, from a WebSocket and from the socket of the service."""

from __future__ import annotations

import json
import math
from collections import Counter
from typing import Any, NoReturn

from drivebus.types import Json

_MAX_INTEGER_DIGITS = 1000  # fewer than sys.int_info.default_max_str_digits, so that Python converts each of them
_SHOWN_CHARACTERS = 40  # of a number or name that is rejected
_SHOWN_NAMES = 10  # of those that are repeated
_MAX_EXACT_INTEGER = 2**53  # a double holds every whole number below it


class MalformedJson(ValueError):
    """Text that is not one JSON document, or one that two parsers could read differently."""

    def __init__(self, problem: str, duplicates: tuple[str, ...] = ()) -> None:
        """``duplicates``: names that occur more than once in one object."""
        super().__init__(problem)
        self.problem, self.duplicates = problem, duplicates


def parse_json(text: bytes | str) -> Any:
    """Parse one JSON document in UTF-8 (RFC 8259): no name twice in an object, no NaN, no float beyond a double.

    JSON has one kind of number, so 60.0 is the integer 60. Raises MalformedJson.
    """
    try:
        return json.loads(
            text.decode("utf-8") if isinstance(text, bytes) else text,
            object_pairs_hook=_object,
            parse_constant=_reject_constant,
            parse_int=_parse_integer,
            parse_float=_parse_float,
        )
    except MalformedJson:
        raise
    except (ValueError, RecursionError) as error:
        raise MalformedJson(type(error).__name__) from None


def _object(pairs: list[tuple[str, Any]]) -> Json:
    members = dict(pairs)
    if len(members) != len(pairs):
        repeated = sorted(name for name, times in Counter(name for name, _ in pairs).items() if times > 1)
        raise MalformedJson("duplicate name", tuple(name[:_SHOWN_CHARACTERS] for name in repeated[:_SHOWN_NAMES]))
    return members


def _reject_constant(text: str) -> NoReturn:
    raise MalformedJson(text)


def _parse_integer(text: str) -> int:
    if len(text) > _MAX_INTEGER_DIGITS:
        raise MalformedJson(text[:_SHOWN_CHARACTERS])
    return int(text)


def _parse_float(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise MalformedJson(text[:_SHOWN_CHARACTERS])
    return int(value) if value.is_integer() and abs(value) < _MAX_EXACT_INTEGER else value
