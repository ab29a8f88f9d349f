"""What a request asks, as the parameters of an operation. Whether they are right is for the plant to say: REST, the
socket and the command line are refused by the same check (S09). Here only what JSON and a query string leave open is
settled: numbers in a query, a name given twice, NaN (T19).
"""

from __future__ import annotations

import json
import math
import re
from typing import Any

from starlette.requests import Request

from drivebus.service.api.param_errors import param_fault, params_error
from drivebus.web.api.table import ApiRoute

Json = dict[str, Any]

_INTEGER = re.compile(r"-?[0-9]{1,18}")
"""No sign but minus, no blank, no full-width digit; longer than any time or count."""


class _InvalidParam(ValueError):
    """What stands wrong, before the operation's own check; ``key`` is a sentence of the room ``params``."""

    def __init__(self, key: str, path: str = "", found: str = "") -> None:
        super().__init__(key)
        self.fault = param_fault(path, found, key)


async def request_params(route: ApiRoute, request: Request) -> Json:
    """The operation's parameters as they were asked. Raises InvalidParameters."""
    try:
        given = _body_params(await request.body()) if route.has_body else _query_params(route, request)
        if not_here := set(request.query_params) if route.has_body else set():
            raise _InvalidParam("in_body", min(not_here))
        if twice := set(given) & set(route.path_params):
            raise _InvalidParam("in_address", min(twice))
    except _InvalidParam as error:
        raise params_error(route.name, [error.fault]) from error
    except (ValueError, RecursionError) as error:
        raise params_error(route.name, [param_fault("", "", "json")]) from error
    return given | {name: request.path_params[name] for name in route.path_params}


def _query_params(route: ApiRoute, request: Request) -> Json:
    """A list for what is a list or was given twice, a whole number for what is one, else the text."""
    query, fields = request.query_params, route.param_schemas()
    return {name: _query_value(query.getlist(name), fields.get(name, {})) for name in query}


def _query_value(values: list[str], schema: Json) -> Any:
    if _has_type(schema, "array"):
        return values
    if len(values) != 1:
        return values
    return int(values[0]) if _has_type(schema, "integer") and _INTEGER.fullmatch(values[0]) else values[0]


def _has_type(schema: Json, kind: str) -> bool:
    return any(one.get("type") == kind for one in (schema, *schema.get("anyOf", ())))


def _body_params(body: bytes) -> Json:
    """One JSON object; no body is an empty one. Raises ValueError, RecursionError."""
    if not body:
        return {}
    found = json.loads(
        body.decode("utf-8"), object_pairs_hook=_unique_keys, parse_constant=_reject_number, parse_float=_parse_number
    )
    if not isinstance(found, dict):
        raise _InvalidParam("object")
    return found


def _unique_keys(pairs: list[tuple[str, Any]]) -> Json:
    """Two values for one name: two readers may take different ones. Raises ValueError."""
    found = dict(pairs)
    if len(found) != len(pairs):
        names = [name for name, _ in pairs]
        raise _InvalidParam("twice", next(name for name in names if names.count(name) > 1))
    return found


def _reject_number(text: str) -> float:
    """``NaN`` and ``Infinity`` are not JSON, though Python reads them. Raises ValueError."""
    raise _InvalidParam("finite", found=text)


def _parse_number(text: str) -> float:
    """JSON has one kind of number: 60.0 is the whole number 60. Raises ValueError."""
    value = float(text)
    if not math.isfinite(value):
        return _reject_number(text)
    return int(value) if value.is_integer() and abs(value) < 2**53 else value
