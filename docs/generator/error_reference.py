"""Reference of the errors: meaning, scope, whether a retry may help, exit code and messages of each class."""

from __future__ import annotations

import ast
import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from drivebus import errors, i18n
from drivebus.cli.errors import exit_code_of
from drivebus.errors import DrivebusError
from drivebus.values import Text
from generator.terms import localized, named_placeholders, table

CHINESE: dict[str, str] = json.loads((Path(__file__).parent / "errors.zh.json").read_text(encoding="utf-8"))
"""Class → Chinese translation of its docstring."""
HEADS = {
    "scope": Text("scope", "影响范围"),
    "again": Text("a retry may help", "重试可能有用"),
    "exit": Text("exit code", "退出码"),
    "key": Text("key", "键"),
    "sentence": Text("message", "文字"),
}
SCOPES = {
    "request": Text("this request", "本次请求"),
    "station": Text("the station", "该站"),
    "port": Text("the whole port", "整个端口"),
    "configuration": Text("none, nothing was sent", "无，未发送任何内容"),
}
YES, NO = Text("yes", "是"), Text("no", "否")


def classes() -> list[type[DrivebusError]]:
    """Return all error classes, a parent before its children."""
    return list(_tree(DrivebusError))


def _tree(parent: type[DrivebusError]) -> Iterator[type[DrivebusError]]:
    yield parent
    for child in parent.__subclasses__():
        if child.__module__ == errors.__name__:
            yield from _tree(child)


def page(language: str) -> str:
    found = raised(Path(errors.__file__).parent)
    return "\n".join(part for error in classes() for part in _entry(error, found.get(error.__name__, set()), language))


def _entry(error: type[DrivebusError], keys: set[str], language: str) -> Iterator[str]:
    parents = " → ".join(base.__name__ for base in reversed(error.__mro__) if issubclass(base, DrivebusError))
    yield f"## {error.__name__}\n"
    yield f"`{parents}`\n"
    text = " ".join((error.__doc__ or "").split()).replace("``", "`")
    if language != "en" and error.__name__ not in CHINESE:
        raise KeyError(f"docs/generator/errors.zh.json has no Chinese docstring of {error.__name__}")
    yield (text if language == "en" else CHINESE[error.__name__]) + "\n"
    row = (
        localized(SCOPES[str(error.scope)], language),
        localized(YES if error.retryable else NO, language),
        int(exit_code_of(error("errors"))),
    )
    yield table([localized(HEADS[name], language) for name in ("scope", "again", "exit")], [row])
    if keys:
        rows = [(f"`{key}`", named_placeholders(i18n.catalogue(language)[key])) for key in sorted(keys)]
        yield table([localized(HEADS["key"], language), localized(HEADS["sentence"], language)], rows)


@cache
def raised(folder: Path) -> dict[str, set[str]]:
    """Return error class → message keys with which the code raises it."""
    names = {error.__name__ for error in classes()}
    found: dict[str, set[str]] = {}
    for file in sorted(folder.rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_bytes())):
            if isinstance(node, ast.Call) and node.args and (name := _called(node)) in names:
                key = node.args[0]
                if isinstance(key, ast.Constant) and isinstance(key.value, str) and i18n.known(key.value):
                    found.setdefault(name, set()).add(key.value)
    return found


def _called(node: ast.Call) -> str:
    target = node.func
    return target.attr if isinstance(target, ast.Attribute) else getattr(target, "id", "")
