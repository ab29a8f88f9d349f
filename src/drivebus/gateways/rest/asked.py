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

from drivebus.errors import ParamsError
from drivebus.gateways.rest.table import Route

Json = dict[str, Any]

_WHOLE = re.compile(r"-?[0-9]{1,18}")
"""No sign but minus, no blank, no full-width digit; longer than any time or count."""


async def params_of(route: Route, request: Request) -> Json:
    """The operation's parameters as they were asked. Raises ParamsError."""
    try:
        given = _of_body(await request.body()) if route.has_body else _of_query(route, request)
        if not_here := set(request.query_params) if route.has_body else set():
            raise ValueError(f"?{min(not_here)}: belongs into the body")
        if twice := set(given) & set(route.places):
            raise ValueError(f"{min(twice)}: stands in the address")
    except (ValueError, RecursionError) as error:
        raise _fault(route.name, str(error)) from error
    return given | {name: request.path_params[name] for name in route.places}


def _of_query(route: Route, request: Request) -> Json:
    """A list for what is a list or was given twice, a whole number for what is one, else the text."""
    query, fields = request.query_params, route.fields()
    return {name: _asked(query.getlist(name), fields.get(name, {})) for name in query}


def _asked(values: list[str], schema: Json) -> Any:
    if _is(schema, "array"):
        return values
    if len(values) != 1:
        return values
    return int(values[0]) if _is(schema, "integer") and _WHOLE.fullmatch(values[0]) else values[0]


def _is(schema: Json, kind: str) -> bool:
    return any(one.get("type") == kind for one in (schema, *schema.get("anyOf", ())))


def _of_body(body: bytes) -> Json:
    """One JSON object; no body is an empty one. Raises ValueError, RecursionError."""
    if not body:
        return {}
    found = json.loads(body.decode("utf-8"), object_pairs_hook=_once, parse_constant=_no_number, parse_float=_number)
    if not isinstance(found, dict):
        raise ValueError("no object")
    return found


def _once(pairs: list[tuple[str, Any]]) -> Json:
    """Two values for one name: two readers may take different ones. Raises ValueError."""
    found = dict(pairs)
    if len(found) != len(pairs):
        raise ValueError("the same name twice")
    return found


def _no_number(text: str) -> float:
    """``NaN`` and ``Infinity`` are not JSON, though Python reads them. Raises ValueError."""
    raise ValueError(f"{text} is no number")


def _number(text: str) -> float:
    """JSON has one kind of number: 60.0 is the whole number 60. Raises ValueError."""
    value = float(text)
    if not math.isfinite(value):
        return _no_number(text)
    return int(value) if value.is_integer() and abs(value) < 2**53 else value


def _fault(operation: str, problem: str) -> ParamsError:
    faults = [{"path": "", "found": "", "expected": problem[:200]}]
    return ParamsError("plant.params", operation=operation, problems=problem[:200], faults=faults)
