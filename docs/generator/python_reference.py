"""Reference of the public Python names: signature and first paragraph of the docstring of each."""

from __future__ import annotations

import ast
import inspect
import json
import textwrap
from collections.abc import Callable, Iterator
from enum import Enum
from importlib import import_module
from pathlib import Path
from typing import Any

from drivebus import blocking, drives, i18n
from drivebus.drives.store import Store
from drivebus.values import Text
from generator.terms import colon, localized

MODULES = ("drivebus", "drivebus.blocking", "drivebus.bus", "drivebus.drives", "drivebus.ports", "drivebus.profiles")
"""Public modules; ``drivebus.errors`` has a page of its own."""
CHINESE: dict[str, str] = json.loads((Path(__file__).parent / "python.zh.json").read_text(encoding="utf-8"))
"""English paragraph → Chinese; a missing one is a KeyError."""
ALSO = Text("Also here, described above: {names}.", "此处也有，见上文：{names}。")
DOCUMENTED_BY: dict[type, type] = {
    blocking.Drive: drives.Drive,
    drives.FileStore: Store,
    drives.MemoryStore: Store,
}
"""Class → class whose method of the same name documents a method without a docstring."""


Function = ast.FunctionDef | ast.AsyncFunctionDef


def page(language: str) -> str:
    return "\n".join(_sections(language))


def public_names() -> Iterator[tuple[str, list[tuple[str, Any]], list[str]]]:
    """Yield each module with the names to describe, and those that an earlier module describes."""
    known: list[Any] = []
    for module in MODULES:
        found = {name: getattr(import_module(module), name) for name in import_module(module).__all__}
        again = [name for name, item in found.items() if any(item is other for other in known)]
        known += found.values()
        yield module, [(name, item) for name, item in found.items() if name not in again], again


def _sections(language: str) -> Iterator[str]:
    for module, names, again in public_names():
        yield f"## `{module}`\n\n{_description(import_module(module), language)}\n"
        if again:
            yield (
                localized(ALSO, language).format(names=i18n.join((f"`{name}`" for name in again), "items", language))
                + "\n"
            )
        for name, item in names:
            yield f"### `{module}.{name}`\n\n```python\n{_heading(name, item)}\n```\n\n{_description(item, language)}\n"
            if inspect.isclass(item):
                yield from _members(item, language)


def _members(class_: type, language: str) -> Iterator[str]:
    fallback, stop = DOCUMENTED_BY.get(class_), colon(language)
    lines = [
        f"- `{_member(name, found)}`{stop}{_description(_function(found), language, getattr(fallback, name, None))}"
        for name, found in members(class_).items()
    ]
    if lines:
        yield "\n".join(lines) + "\n"


def members(class_: type) -> dict[str, Any]:
    """Return public methods and properties, also those of base classes of the package."""
    ours = [base for base in class_.__mro__ if base.__module__.startswith("drivebus")]
    kinds = (property, classmethod, staticmethod)
    return {
        name: found
        for base in reversed(ours)
        for name, found in vars(base).items()
        if not name.startswith("_") and (isinstance(found, kinds) or inspect.isfunction(found))
    }


def _description(found: Any, language: str, fallback: Any = None) -> str:
    """Return the description of an object. Raises KeyError if it has none, or none in this language."""
    text = paragraph(found) or (paragraph(fallback) if fallback is not None else "")
    if not text:
        raise KeyError(f"{found!r} has no docstring")
    if language != "en" and text not in CHINESE:
        raise KeyError(f"docs/generator/python.zh.json has no Chinese for {text!r}")
    return text if language == "en" else CHINESE[text]


def paragraph(found: Any) -> str:
    """Return the first paragraph of an object's own docstring."""
    own = getattr(found, "__doc__", None) or ""
    return " ".join(inspect.cleandoc(own).split("\n\n")[0].split()).replace("``", "`")


# --- signatures ---------------------------------------------------------------------------------------------------


def _function(found: Any) -> Any:
    if isinstance(found, property):
        return found.fget
    return getattr(found, "__func__", found)


def _member(name: str, found: Any) -> str:
    if isinstance(found, property):
        node = _node(found.fget)
        return f"{name}: {ast.unparse(node.returns)}" if node.returns is not None else name
    return _call(name, _node(_function(found)), bound=not isinstance(found, staticmethod))


def _heading(name: str, item: Any) -> str:
    """Return the signature of an object: a call, the fields of a dataclass, or the members of an enum."""
    if not inspect.isclass(item):
        return _call(name, _node(item))
    if issubclass(item, Enum):
        return "\n".join(
            [f"class {name}", *(f"    {word} = {found.value!r}" for word, found in item.__members__.items())]
        )
    body = _class(item).body
    constructor = next((line for line in body if isinstance(line, ast.FunctionDef) and line.name == "__init__"), None)
    if constructor is not None:
        return _call(name, constructor, bound=True)
    return "\n".join(
        [f"class {name}", *(f"    {ast.unparse(line)}" for line in body if isinstance(line, ast.AnnAssign))]
    )


def _call(name: str, node: Function, *, bound: bool = False) -> str:
    arguments = node.args
    if bound:
        (arguments.posonlyargs or arguments.args).pop(0)
    returns = f" -> {ast.unparse(node.returns)}" if node.returns is not None and name[0].islower() else ""
    waited = "await " if isinstance(node, ast.AsyncFunctionDef) else ""
    return f"{waited}{name}({ast.unparse(arguments)}){returns}"


def _node(function: Callable[..., Any]) -> Function:
    found = ast.parse(textwrap.dedent(inspect.getsource(function))).body[0]
    assert isinstance(found, Function)
    return found


def _class(class_: type) -> ast.ClassDef:
    found = ast.parse(textwrap.dedent(inspect.getsource(class_))).body[0]
    assert isinstance(found, ast.ClassDef)
    return found
