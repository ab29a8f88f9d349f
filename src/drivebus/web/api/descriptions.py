"""How a route describes itself in OpenAPI: parameters and bodies from the operation's own model, answers, errors."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel

from drivebus import i18n
from drivebus.service.api import responses
from drivebus.service.api.examples import PARAM_EXAMPLES
from drivebus.web.api.table import ApiRoute

Json = dict[str, Any]

RESPONSE_MODELS: dict[str, type[BaseModel]] = {
    "plant.statistics": responses.StatisticsResponse,
    "drives.list": responses.DrivesResponse,
    "drives.get": responses.DriveObject,
    "parameters.read": responses.ParametersResponse,
    "parameters.write": responses.OutcomeResponse,
    "lease.take": responses.LeaseResponse,
    "lease.renew": responses.LeaseResponse,
    "drive.arm": responses.ArmResponse,
    "drive.run": responses.OutcomeResponse,
    "drive.set_frequency": responses.OutcomeResponse,
    "drive.stop": responses.OutcomeResponse,
    "drive.jog": responses.JogResponse,
    "drive.jog_end": responses.OutcomeResponse,
    "drive.reset": responses.OutcomeResponse,
    "groups.list": responses.GroupsResponse,
    "group.arm": responses.ArmResponse,
    "group.start": responses.OutcomesResponse,
    "group.set_frequency": responses.OutcomesResponse,
    "group.stop": responses.OutcomesResponse,
    "plant.stop": responses.StopAllResponse,
    "buses.list": responses.BusesResponse,
    "buses.frames": responses.FramesResponse,
    "history.tags": responses.TagsResponse,
    "history.trend": responses.TrendResponse,
    "history.markers": responses.PageResponse,
    "alarms.list": responses.ActiveAlarmsResponse,
    "alarms.history": responses.PageResponse,
    "cases.list": responses.PageResponse,
    "audit.list": responses.PageResponse,
    "audit.verify": responses.AuditVerificationResponse,
}
"""Operations that are not here answer an object that the reference describes in words only."""

STATUS_MEANINGS = {
    401: "not logged in, or the session is over",
    403: "no right to do this, or a request from a foreign page",
    404: "nothing of that name",
    405: "not in this way: another method",
    408: "the body did not come within ten seconds",
    409: "not now: what must come first is said",
    413: "larger than 1 MiB; than 4 KiB where no right is needed",
    415: "not application/json",
    422: "wrong parameters, outside a limit, or nothing this drive can do; nothing was sent",
    429: "too many attempts",
    502: "the drive or its line said no, or answered something else",
    503: "the plant or its audit trail can't be reached; nothing was started",
    504: "sent, and nobody can say whether it was done",
}
"""One shape for all of them: ``Problem``."""


def route_options(route: ApiRoute) -> Json:
    """What FastAPI is told about a route."""
    return {
        "summary": i18n.text(f"api.{route.name}", "en"),
        "description": _description(route),
        "tags": [route.path.split("/")[1]],
        "response_model": None,
        "responses": _responses(route),
        "openapi_extra": _request_schema(route),
    }


def _description(route: ApiRoute) -> str:
    return f"Needs the right `{route.operation.right}`." + (" Audited." if route.operation.mutates else "")


def _responses(route: ApiRoute) -> dict[int | str, Json]:
    fine: Json = {"description": "done", "model": RESPONSE_MODELS.get(route.name, responses.ApiObject)}
    if route.name == "history.export":
        fine = {"description": "the file", "content": _EXPORT_CONTENT}
    told: dict[int | str, Json] = {200: fine}
    return told | {
        code: {"description": why, "model": responses.ErrorResponse} for code, why in STATUS_MEANINGS.items()
    }


_EXPORT_CONTENT = {
    "text/csv": {"schema": {"type": "string"}},
    "application/vnd.apache.parquet": {"schema": {"type": "string", "format": "binary"}},
}


def _request_schema(route: ApiRoute) -> Json:
    """Parameters of path and query, or the body."""
    schema = route.operation.params.model_json_schema()["properties"] if route.path_params else {}
    places = [
        {
            "name": name,
            "in": "path",
            "required": True,
            "schema": _without_title(schema[name]),
            "example": PARAM_EXAMPLES[name],
        }
        for name in route.path_params
    ]
    if route.has_body:
        return {"parameters": places, "requestBody": _request_body(route)}
    return {"parameters": places + _query_parameters(route)}


def _query_parameters(route: ApiRoute) -> list[Json]:
    required = route.required_params()
    return [
        {"name": name, "in": "query", "required": name in required, "schema": _query_schema(schema)}
        | ({"example": PARAM_EXAMPLES[name]} if name in PARAM_EXAMPLES else {})
        for name, schema in route.param_schemas().items()
    ]


def _query_schema(schema: Json) -> Json:
    """A query can't say null: what may be left out is just not required."""
    kept = [one for one in schema.get("anyOf", ()) if one.get("type") != "null"]
    outer = {name: value for name, value in schema.items() if name != "anyOf" and value is not None}
    return _without_title(outer | (kept[0] if kept else {}))


def _request_body(route: ApiRoute) -> Json:
    """One JSON object; without required fields it may be left out."""
    fields = {name: _without_title(schema) for name, schema in route.param_schemas().items()}
    schema = {
        "type": "object",
        "properties": fields,
        "required": route.required_params(),
        "additionalProperties": False,
    }
    example = {name: PARAM_EXAMPLES[name] for name in fields if name in PARAM_EXAMPLES}
    content = {"application/json": {"schema": schema, "example": example}}
    return {"content": content, "required": bool(route.required_params())}


def _without_title(schema: Json) -> Json:
    """Without the titles that pydantic makes out of names."""
    return {name: value for name, value in schema.items() if name != "title"}
