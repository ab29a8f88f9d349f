"""OpenAPI description of the API, from the declarations of the operations."""

from __future__ import annotations

import re
from functools import cache

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from starlette.responses import JSONResponse, Response

from drivebus.service.api.operations import Operation
from drivebus.service.api.operations.outcomes import ErrorResponse
from drivebus.service.auth.rights import AccessLevel, RequiredAccess
from drivebus.types import Json
from drivebus.values import Text

API_TITLE = "drivebus"
API_VERSION = "1"  # of the API, not of the program: it changes with an incompatible change
COOKIE_SCHEME = "session"
TOKEN_SCHEME = "token"
CSRF_SCHEME = "csrf"
SECURITY_SCHEMES: Json = {
    COOKIE_SCHEME: {
        "type": "apiKey",
        "in": "cookie",
        "name": "drivebus_session",
        "description": "From POST /login. `__Host-drivebus` where the service speaks TLS.",
    },
    CSRF_SCHEME: {
        "type": "apiKey",
        "in": "header",
        "name": "X-Drivebus-CSRF",
        "description": "From GET /session; beside the cookie on everything but GET.",
    },
    TOKEN_SCHEME: {"type": "http", "scheme": "bearer", "description": "A token of this service, from POST /tokens."},
}
STATUS_MEANINGS = {
    401: Text("not logged in, or the session is over", "未登录，或会话已结束"),
    403: Text("no right to do this, or a request from a foreign page", "没有此权限，或请求来自外部页面"),
    404: Text("no resource of that name", "没有该名称的资源"),
    405: Text("the path does not support this method", "该路径不支持此请求方法"),
    408: Text("the body did not arrive within ten seconds", "请求体没有在十秒内到达"),
    409: Text("not possible now; the text names the condition", "当前不允许；文本中说明所需条件"),
    413: Text("body larger than 1 MiB, or 4 KiB where no right is needed", "请求体超过 1 MiB；无需权限的路径为 4 KiB"),
    415: Text("not application/json", "不是 application/json"),
    422: Text(
        "wrong parameters, outside a limit, or nothing this drive can do; nothing was sent",
        "参数错误、超出限值或该变频器不支持；未发送任何指令",
    ),
    429: Text(
        "too many attempts, or too many refused commands; `Retry-After` is the wait in seconds",
        "尝试次数过多，或被拒绝的命令过多；`Retry-After` 为等待秒数",
    ),
    500: Text("internal error; whether it was done is not known", "内部错误；是否已执行不得而知"),
    502: Text("the drive or its bus failed, or the drive rejected it", "变频器或总线出错，或变频器拒绝"),
    503: Text(
        "the service or its audit trail cannot be reached, or too many requests are waiting; nothing was started. With "
        "the code `plant.gone`, `plant.hangs` or `plant.internal` it is not known whether it was done",
        "无法连接服务或其审计记录，或等待的请求过多；未执行任何操作。代码为 `plant.gone`、"
        "`plant.hangs` 或 `plant.internal` 时，是否已执行不得而知",
    ),
    504: Text("sent, but the outcome is unknown", "已发送，结果未知"),
}
"""Meaning of each error status; all have the shape of ``ErrorResponse``."""
_UNUSED_SCHEMAS = ("HTTPValidationError", "ValidationError")  # FastAPI's own shape of an error
_ACCESS: dict[RequiredAccess, str] = {
    AccessLevel.PUBLIC: "Needs no credential.",
    AccessLevel.SESSION: "Needs the session of a browser.",
}


def operation_options(operation: Operation) -> Json:
    """Return FastAPI's options for the route of an operation."""
    done: Json = {"description": "done", "model": operation.response}
    if operation.media_types:
        done = {
            "description": "done",
            "content": {media_type: _content(media_type) for media_type in operation.media_types},
        }
    errors = {code: {"description": text.en, "model": ErrorResponse} for code, text in STATUS_MEANINGS.items()}
    return {
        "operation_id": re.sub(r"\W", "_", operation.name),
        "summary": operation.summary.en,
        "description": _ACCESS.get(operation.right, f"Needs the right `{operation.right}`.")
        + (" Audited." if operation.mutates else ""),
        "tags": [operation.tag],
        "response_model": None,
        "response_class": Response if operation.media_types else JSONResponse,  # its media type is described as well
        "responses": {200: done} | errors,
        "openapi_extra": _request_schema(operation) | {"x-right": operation.right},
    }


def _content(media_type: str) -> Json:
    """Return the content of a result that is no JSON."""
    is_text = media_type.startswith("text/") or media_type.endswith("text")
    return {"schema": {"type": "string"} if is_text else {"type": "string", "format": "binary"}}


def _request_schema(operation: Operation) -> Json:
    schemas = operation.all_param_schemas()
    parameters = [
        {"name": name, "in": "path", "required": True} | _schema_and_example(schemas[name])
        for name in operation.path_params
    ]
    if operation.has_body:
        return {"parameters": parameters, "requestBody": _request_body(operation)}
    required = operation.required_params()
    parameters += [
        {"name": name, "in": "query", "required": name in required} | _schema_and_example(_query_schema(schema))
        for name, schema in operation.param_schemas().items()
    ]
    return {"parameters": parameters}


def _schema_and_example(schema: Json) -> Json:
    example = {"example": schema["examples"][0]} if "examples" in schema else {}
    return {"schema": _plain_schema(schema)} | example


def _query_schema(schema: Json) -> Json:
    """Return a schema without null, which a query cannot express: an optional parameter is not required."""
    options = [alternative for alternative in schema.get("anyOf", ()) if alternative.get("type") != "null"]
    outer = {name: value for name, value in schema.items() if name != "anyOf" and value is not None}
    return outer | (options[0] if options else {})


def _request_body(operation: Operation) -> Json:
    """Return the request body: one JSON object, optional where no field is required."""
    fields = {name: _plain_schema(schema) for name, schema in operation.param_schemas().items()}
    required = operation.required_params()
    schema = {"type": "object", "properties": fields, "required": required, "additionalProperties": False}
    example = {name: value for name, value in operation.example.items() if name in fields}
    return {"content": {"application/json": {"schema": schema, "example": example}}, "required": bool(required)}


def _plain_schema(schema: Json) -> Json:
    """Return a schema without pydantic's titles and without examples, which OpenAPI has beside it."""
    return {name: value for name, value in schema.items() if name not in ("title", "examples")}


def openapi_document(app: FastAPI) -> Json:
    """Return the description of an app."""
    document = get_openapi(
        title=API_TITLE, version=API_VERSION, routes=app.routes, summary="One plant of drives on many buses"
    )
    components = document.setdefault("components", {})
    components["securitySchemes"] = SECURITY_SCHEMES
    for name in _UNUSED_SCHEMAS:
        components.get("schemas", {}).pop(name, None)
    for operations in document["paths"].values():
        for method, operation in operations.items():
            operation["responses"] = operation["responses"] | _error_responses()
            operation["security"] = _security(method, operation["x-right"])
    return document


def _error_responses() -> Json:
    content = {"application/json": {"schema": {"$ref": "#/components/schemas/ErrorResponse"}}}
    return {str(code): {"description": text.en, "content": content} for code, text in STATUS_MEANINGS.items()}


def _security(method: str, required: RequiredAccess) -> list[Json]:
    """Return the accepted credentials: a token, or a cookie with the CSRF header where the method is not GET."""
    cookie: Json = {COOKIE_SCHEME: []} if method == "get" else {COOKIE_SCHEME: [], CSRF_SCHEME: []}
    if required == AccessLevel.PUBLIC:
        return [{}, {TOKEN_SCHEME: []}, cookie]
    return [cookie] if required == AccessLevel.SESSION else [{TOKEN_SCHEME: []}, cookie]


def install_openapi(app: FastAPI) -> None:
    """Let the app describe itself; the description is made once."""

    @cache
    def openapi() -> Json:
        return openapi_document(app)

    app.openapi = openapi  # type: ignore[method-assign]
