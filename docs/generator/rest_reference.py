"""Reference of the REST API: access, parameters and result of every route, from the declarations."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from drivebus import i18n
from drivebus.service.api.operations import OPERATIONS, Operation
from drivebus.service.auth.rights import AccessLevel, RequiredAccess
from drivebus.types import Json
from drivebus.values import Text
from drivebus.web.api.openapi import STATUS_MEANINGS
from drivebus.web.app import declared_routes
from drivebus.web.operations import WEB_OPERATIONS
from generator.terms import localized, table

HEADS = {
    "path": Text("path", "路径"),
    "access": Text("access", "访问条件"),
    "status": Text("status", "状态码"),
    "meaning": Text("meaning", "含义"),
    "parameter": Text("parameter", "参数"),
    "in": Text("in", "位置"),
    "value": Text("value", "取值"),
    "required": Text("required", "必需"),
}
PLACES = {"path": Text("path", "路径"), "query": Text("query", "查询"), "body": Text("body", "正文")}
YES, NO = Text("yes", "是"), Text("no", "否")
RIGHT = Text("Right: `{right}`.", "权限：`{right}`。")
AUDITED = Text(" Written into the audit trail.", "记入审计记录。")
RESULT = Text("Result: {keys}.", "结果：{keys}。")
ACCESS: dict[RequiredAccess, Text] = {
    AccessLevel.PUBLIC: Text("Needs no credential.", "无需凭证。"),
    AccessLevel.SESSION: Text("Needs the session of a browser.", "需要浏览器会话。"),
}


def parts(language: str) -> dict[str, str]:
    """Return the generated parts of ``docs/reference/rest-api.md``."""
    return {
        "errors": _errors(language),
        "operations": _operations(OPERATIONS.values(), language),
        "account": _operations(WEB_OPERATIONS.values(), language),
        "exempt": _exempt(language),
    }


def _errors(language: str) -> str:
    rows = [[status, localized(text, language)] for status, text in STATUS_MEANINGS.items()]
    return table(_heads("status", "meaning", language=language), rows)


def _exempt(language: str) -> str:
    """Return the table of routes that are no operations: files of the page, live values."""
    operations = {
        (operation.method, operation.url_path) for operation in (*OPERATIONS.values(), *WEB_OPERATIONS.values())
    }
    rows = [
        (f"`{route.method} {route.path}`", f"`{route.access}`")
        for route in declared_routes()
        if (route.method, route.path) not in operations
    ]
    return table(_heads("path", "access", language=language), rows)


def _operations(operations: Iterable[Operation], language: str) -> str:
    return "\n".join(part for operation in operations for part in _operation(operation, language))


def _operation(operation: Operation, language: str) -> Iterator[str]:
    yield f"### `{operation.method} {operation.url_path}`\n"
    right = localized(ACCESS.get(operation.right, RIGHT), language).format(right=operation.right)
    audited = localized(AUDITED, language) if operation.mutates else ""
    stop, blank = (".", " ") if language == "en" else ("。", "")
    summary = localized(operation.summary, language)
    yield f"{summary}{stop}{blank}{right}{audited}{blank}{_result(operation, language)}".strip() + "\n"
    if rows := [*_rows(operation, language)]:
        yield table(_heads("parameter", "in", "value", "required", language=language), rows)


def _result(operation: Operation, language: str) -> str:
    names = operation.media_types if operation.response is None else tuple(operation.response.model_fields)
    keys = i18n.join((f"`{name}`" for name in names or ("{}",)), "items", language)
    return localized(RESULT, language).format(keys=keys)


def _rows(operation: Operation, language: str) -> Iterator[list[str]]:
    schemas = operation.all_param_schemas()
    required = operation.required_params()
    for name in operation.path_params:
        yield [
            f"`{name}`",
            localized(PLACES["path"], language),
            _value(schemas[name], language),
            localized(YES, language),
        ]
    where = localized(PLACES["body" if operation.has_body else "query"], language)
    for name, schema in operation.param_schemas().items():
        yield [f"`{name}`", where, _value(schema, language), localized(YES if name in required else NO, language)]


def _value(schema: Json, language: str) -> str:
    """Return type, range and default of a parameter in the words of JSON Schema, which need no translation."""
    options = [option for option in schema.get("anyOf", ()) if option.get("type") != "null"]
    found = (options[0] if options else {}) | {name: value for name, value in schema.items() if name != "anyOf"}
    listed = i18n.join((f'`"{value}"`' for value in found.get("enum", ())), "items", language)
    words = [listed or str(found.get("type", ""))]
    words += [f"{sign} {found[name]:g}" for name, sign in (("minimum", "≥"), ("maximum", "≤")) if name in found]
    if "items" in found:
        words.append(f"{found.get('minItems', 0)}–{found['maxItems']}")
    if "maxLength" in found:
        words.append(f"{found.get('minLength', 0)}–{found['maxLength']}")
    if "pattern" in found:
        words.append(f"`{found['pattern']}`")
    return " ".join(words) + (f" = `{found['default']}`" if found.get("default") is not None else "")


def _heads(*names: str, language: str) -> list[str]:
    return [localized(HEADS[name], language) for name in names]
