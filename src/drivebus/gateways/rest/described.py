"""How a route describes itself in OpenAPI: parameters and bodies from the operation's own model, answers, errors."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel

from drivebus import i18n
from drivebus.gateways.rest import answers
from drivebus.gateways.rest.examples import EXAMPLES
from drivebus.gateways.rest.table import Route

Json = dict[str, Any]

ANSWERS: dict[str, type[BaseModel]] = {
    "plant.statistics": answers.Statistics,
    "drives.list": answers.Drives,
    "drives.get": answers.Drive,
    "parameters.read": answers.Parameters,
    "parameters.write": answers.Done,
    "lease.take": answers.Leased,
    "lease.renew": answers.Leased,
    "drive.arm": answers.Armed,
    "drive.run": answers.Done,
    "drive.set_frequency": answers.Done,
    "drive.stop": answers.Done,
    "drive.jog": answers.Jogging,
    "drive.jog_end": answers.Done,
    "drive.reset": answers.Done,
    "groups.list": answers.Groups,
    "group.arm": answers.Armed,
    "group.start": answers.Outcomes,
    "group.set_frequency": answers.Outcomes,
    "group.stop": answers.Outcomes,
    "plant.stop": answers.PlantStopped,
    "buses.list": answers.Buses,
    "buses.frames": answers.Frames,
    "history.tags": answers.Tags,
    "history.trend": answers.Trend,
    "history.markers": answers.Page,
    "alarms.list": answers.Active,
    "alarms.history": answers.Page,
    "cases.list": answers.Page,
    "audit.list": answers.Page,
    "audit.verify": answers.Verified,
}
"""Operations that are not here answer an object that the reference describes in words only."""

ERRORS = {
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


def of(route: Route) -> Json:
    """What FastAPI is told about a route."""
    return {
        "summary": i18n.text(f"api.{route.name}", "en"),
        "description": _rights(route),
        "tags": [route.path.split("/")[1]],
        "response_model": None,
        "responses": _responses(route),
        "openapi_extra": _asked(route),
    }


def _rights(route: Route) -> str:
    return f"Needs the right `{route.operation.right}`." + (" Audited." if route.operation.changes else "")


def _responses(route: Route) -> dict[int | str, Json]:
    fine: Json = {"description": "done", "model": ANSWERS.get(route.name, answers.Answer)}
    if route.name == "history.export":
        fine = {"description": "the file", "content": _FILES}
    told: dict[int | str, Json] = {200: fine}
    return told | {code: {"description": why, "model": answers.Problem} for code, why in ERRORS.items()}


_FILES = {
    "text/csv": {"schema": {"type": "string"}},
    "application/vnd.apache.parquet": {"schema": {"type": "string", "format": "binary"}},
}


def _asked(route: Route) -> Json:
    """Parameters of path and query, or the body."""
    schema = route.operation.params.model_json_schema()["properties"] if route.places else {}
    places = [
        {"name": name, "in": "path", "required": True, "schema": _plain(schema[name]), "example": EXAMPLES[name]}
        for name in route.places
    ]
    if route.has_body:
        return {"parameters": places, "requestBody": _body(route)}
    return {"parameters": places + _query(route)}


def _query(route: Route) -> list[Json]:
    required = route.required()
    return [
        {"name": name, "in": "query", "required": name in required, "schema": _in_query(schema)}
        | ({"example": EXAMPLES[name]} if name in EXAMPLES else {})
        for name, schema in route.fields().items()
    ]


def _in_query(schema: Json) -> Json:
    """A query can't say null: what may be left out is just not required."""
    kept = [one for one in schema.get("anyOf", ()) if one.get("type") != "null"]
    outer = {name: value for name, value in schema.items() if name != "anyOf" and value is not None}
    return _plain(outer | (kept[0] if kept else {}))


def _body(route: Route) -> Json:
    """One JSON object; without required fields it may be left out."""
    fields = {name: _plain(schema) for name, schema in route.fields().items()}
    schema = {"type": "object", "properties": fields, "required": route.required(), "additionalProperties": False}
    example = {name: EXAMPLES[name] for name in fields if name in EXAMPLES}
    content = {"application/json": {"schema": schema, "example": example}}
    return {"content": content, "required": bool(route.required())}


def _plain(schema: Json) -> Json:
    """Without the titles that pydantic makes out of names."""
    return {name: value for name, value in schema.items() if name != "title"}
