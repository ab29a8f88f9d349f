"""The API as a page: every address with its right, parameters and answer, from the table that routes are made of."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from drivebus import i18n
from drivebus.profiles.model import Text
from drivebus.web.api.descriptions import RESPONSE_MODELS, STATUS_MEANINGS
from drivebus.web.api.table import API_PREFIX, API_ROUTES, ApiRoute
from drivebus.web.route_policy import ROUTE_POLICIES
from generator.words import side, table

Json = dict[str, Any]

HEADS = {
    "address": Text("address", "地址"),
    "needs": Text("needs", "需要"),
    "status": Text("status", "状态码"),
    "meaning": Text("meaning", "含义"),
    "parameter": Text("parameter", "参数"),
    "in": Text("in", "位置"),
    "value": Text("value", "取值"),
    "must": Text("must be given", "必需"),
}
PLACES = {"path": Text("path", "路径"), "query": Text("query", "查询"), "body": Text("body", "正文")}
YES, NO = Text("yes", "是"), Text("no", "否")
RIGHT = Text("Right: `{right}`.", "权限：`{right}`。")
AUDITED = Text(" Written into the audit trail.", "记入审计记录。")
ANSWER = Text("Answer: {keys}.", "应答：{keys}。")
FILE = Text("Answer: the file itself.", "应答：文件本身。")
MEANINGS = {
    401: "未登录，或会话已结束",
    403: "没有此权限，或请求来自外部页面",
    404: "没有这个名称",
    405: "不能用这种方式：请用别的方法",
    408: "请求体没有在十秒内到达",
    409: "现在不行：会说明须先做什么",
    413: "超过 1 MiB；不需要权限处超过 4 KiB",
    415: "不是 application/json",
    422: "参数错误、超出限值或该变频器做不到；未发送任何东西",
    429: "尝试次数过多",
    502: "变频器或线路拒绝，或给出别的应答",
    503: "无法连接工厂或其审计记录；未启动任何东西",
    504: "已发送，但无人知道是否已执行",
}


def parts(language: str) -> dict[str, str]:
    """The generated parts of ``docs/reference/rest-api.md``."""
    return {"errors": _errors(language), "operations": _operations(language), "account": _account(language)}


def _errors(language: str) -> str:
    said = STATUS_MEANINGS if language == "en" else MEANINGS
    return table(_heads("status", "meaning", language=language), [[code, said[code]] for code in STATUS_MEANINGS])


def _account(language: str) -> str:
    """What the door itself answers: who is it, users, tokens."""
    ours = {(route.method, API_PREFIX + route.path) for route in API_ROUTES}
    rows = [
        (f"`{one.method} {one.path}`", f"`{one.access}`")
        for one in ROUTE_POLICIES
        if (one.method, one.path) not in ours
    ]
    return table(_heads("address", "needs", language=language), rows)


def _operations(language: str) -> str:
    return "\n".join(part for route in API_ROUTES for part in _route(route, language))


def _route(route: ApiRoute, language: str) -> Iterator[str]:
    yield f"### `{route.method} {API_PREFIX}{route.path}`\n"
    right = side(RIGHT, language).format(right=route.operation.right)
    audited = side(AUDITED, language) if route.operation.mutates else ""
    stop = "." if language == "en" else "。"
    blank = " " if language == "en" else ""
    said = f"{i18n.text(f'api.{route.name}', language)}{stop}{blank}{right}{audited}{blank}{_answer(route, language)}"
    yield said.strip() + "\n"
    rows = [*_rows(route, language)]
    if rows:
        yield table(_heads("parameter", "in", "value", "must", language=language), rows)


def _answer(route: ApiRoute, language: str) -> str:
    if route.name == "history.export":
        return side(FILE, language)
    model = RESPONSE_MODELS.get(route.name)
    keys = [f"`{name}`" for name in model.model_fields] if model is not None else []
    return side(ANSWER, language).format(keys=", ".join(keys)) if keys else ""


def _rows(route: ApiRoute, language: str) -> Iterator[list[str]]:
    schemas = route.operation.params.model_json_schema().get("properties", {})
    required = route.required_params()
    for name in route.path_params:
        yield [f"`{name}`", side(PLACES["path"], language), _value(schemas[name]), side(YES, language)]
    where = side(PLACES["body" if route.has_body else "query"], language)
    for name, schema in route.param_schemas().items():
        must = side(YES if name in required else NO, language)
        yield [f"`{name}`", where, _value(schema), must]


def _value(schema: Json) -> str:
    """Type, range and default in the signs of JSON Schema, which need no translation."""
    options = [one for one in schema.get("anyOf", ()) if one.get("type") != "null"]
    found = (options[0] if options else {}) | {name: value for name, value in schema.items() if name != "anyOf"}
    words = [", ".join(f'`"{one}"`' for one in found["enum"]) if "enum" in found else str(found.get("type", ""))]
    words += [f"{sign} {found[name]:g}" for name, sign in (("minimum", "≥"), ("maximum", "≤")) if name in found]
    if "items" in found:
        words.append(f"{found['minItems']}–{found['maxItems']}")
    if "maxLength" in found:
        words.append(f"{found.get('minLength', 0)}–{found['maxLength']}")
    if "pattern" in found:
        words.append(f"`{found['pattern']}`")
    return " ".join(words) + (f" = `{found['default']}`" if found.get("default") is not None else "")


def _heads(*names: str, language: str) -> list[str]:
    return [side(HEADS[name], language) for name in names]
