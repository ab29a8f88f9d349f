"""Loader of the modules under test: records the statements that a test runs, and replaces code by mutants."""

from __future__ import annotations

import ast
import gc
import sys
from collections.abc import Callable, Iterator
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from types import CodeType, FunctionType
from typing import Any

StatementHit = tuple[str, int]
"""Module and line of an executed statement in a function."""
EXECUTED: set[StatementHit] = set()
PROBE_NAME = "__drivebus_executed__"
FunctionKey = tuple[str, int]
"""Qualified name and first line of a function."""


class MutatedModuleFinder(MetaPathFinder):
    """Import finder that passes the source of ``modules`` through ``change``."""

    def __init__(self, modules: frozenset[str], change: Callable[[str, ast.Module], None]) -> None:
        self.modules, self.change = modules, change

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> ModuleSpec | None:
        if fullname not in self.modules:
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        assert spec is not None and spec.origin is not None
        spec.loader = _MutatedModuleLoader(fullname, spec.origin, self.change)
        return spec


class _MutatedModuleLoader(SourceFileLoader):
    def __init__(self, fullname: str, path: str, change: Callable[[str, ast.Module], None]) -> None:
        super().__init__(fullname, path)
        self.change = change

    def get_code(self, fullname: str) -> CodeType:
        tree = ast.parse(self.get_data(self.path))
        self.change(fullname, tree)
        return compile(tree, self.path, "exec", dont_inherit=True)

    def exec_module(self, module: Any) -> None:
        module.__dict__[PROBE_NAME] = EXECUTED.add
        super().exec_module(module)


def insert_probes(module: str, tree: ast.Module) -> None:
    """Insert a probe before each statement of every function."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            _probe_blocks(module, node)


def _probe_blocks(module: str, parent: ast.AST) -> None:
    for name in ("body", "orelse", "finalbody"):
        block = getattr(parent, name, None)
        if isinstance(block, list):
            setattr(parent, name, [part for node in block for part in (_probe(module, node), node)])
    for node in ast.iter_child_nodes(parent):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.expr):
            _probe_blocks(module, node)


def _probe(module: str, node: ast.stmt) -> ast.stmt:
    text = f"{PROBE_NAME}(({module!r}, {node.lineno}))"
    probe = ast.parse(text).body[0]
    for part in ast.walk(probe):
        if hasattr(part, "lineno"):
            ast.copy_location(part, node)
    return probe


def loaded_functions(path: str) -> dict[FunctionKey, list[FunctionType]]:
    """Return every loaded function of the file ``path``, also decorated functions, properties and closures."""
    found: dict[FunctionKey, list[FunctionType]] = {}
    gc.unfreeze()  # pytest's configuration freezes the modules that are loaded before the first test
    for candidate in gc.get_objects():
        if isinstance(candidate, FunctionType) and candidate.__code__.co_filename == path:
            code = candidate.__code__
            found.setdefault((code.co_qualname, code.co_firstlineno), []).append(candidate)
    return found


def swap(originals: dict[FunctionKey, list[FunctionType]], changed: CodeType) -> None:
    """Give each loaded function its code of the changed module. Raises ValueError where a closure has changed."""
    for code in _codes(changed):
        for function in originals.get((code.co_qualname, code.co_firstlineno), ()):
            function.__code__ = code


def _codes(code: CodeType) -> Iterator[CodeType]:
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield constant
            yield from _codes(constant)


def unload_packages(prefixes: tuple[str, ...]) -> None:
    """Remove these packages from the loaded modules."""
    for name in [name for name in sys.modules if name.startswith(prefixes)]:
        del sys.modules[name]
