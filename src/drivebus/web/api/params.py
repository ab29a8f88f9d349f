"""Parameters of an operation from a request: its path, and its parsed body or its query.

Types and ranges are checked by the model of the operation. Here only what a query string leaves open is settled:
numbers, booleans, and a name given twice.
"""

from __future__ import annotations

import re
from typing import Any

from starlette.requests import Request

from drivebus.service.api.errors import param_fault, params_error
from drivebus.service.api.operations import Operation
from drivebus.types import Json

_BOOLEANS = {"true": True, "false": False}
_INTEGER = re.compile(r"-?[0-9]{1,18}")
"""No sign but minus, no blank, ASCII digits only; 18 digits hold every time and count."""


def request_params(operation: Operation, request: Request) -> Json:
    """Return the parameters of ``operation`` as they were sent. Raises InvalidParameters."""
    if operation.has_body:
        params: Json = request.state.body
        if not isinstance(params, dict):
            raise params_error(operation.name, [param_fault("", "", "object")])
        if request.query_params:
            raise params_error(operation.name, [param_fault(min(request.query_params), "", "in_body")])
    else:
        params = _query_params(operation, request)
    if duplicates := set(params) & set(operation.path_params):
        raise params_error(operation.name, [param_fault(min(duplicates), "", "in_address")])
    return params | {name: request.path_params[name] for name in operation.path_params}


def _query_params(operation: Operation, request: Request) -> Json:
    """Return the parameters of a query by name, as the schemas type them.

    A list parameter and a repeated name give a list, integers and booleans their value, all others the text.
    """
    schemas, values_by_name = operation.param_schemas(), dict[str, list[str]]()
    for name, value in request.query_params.multi_items():
        values_by_name.setdefault(name, []).append(value)
    return {name: _query_value(values, schemas.get(name, {})) for name, values in values_by_name.items()}


def _query_value(values: list[str], schema: Json) -> Any:
    if _has_type(schema, "array") or len(values) != 1:
        return values
    if _has_type(schema, "boolean") and values[0] in _BOOLEANS:
        return _BOOLEANS[values[0]]
    is_integer = _has_type(schema, "integer") and _INTEGER.fullmatch(values[0])
    return int(values[0]) if is_integer else values[0]


def _has_type(schema: Json, kind: str) -> bool:
    return any(alternative.get("type") == kind for alternative in (schema, *schema.get("anyOf", ())))
