"""Mutants of a module: small changes of its source, one at a time. Nothing is run here.

Not changed: docstrings, annotations, decorators, ``__slots__``, ``__all__``, aliases of types, asserts, the text of a
``ValueError``, and what only a type checker reads.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

COMPARE: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
SWAPPED_OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Add,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.FloorDiv,
    ast.Pow: ast.Mult,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.BitXor: ast.BitAnd,
}
SWAPPED_NAMES = {
    "min": "max",
    "max": "min",
    "any": "all",
    "all": "any",
    "startswith": "endswith",
    "endswith": "startswith",
}
TABLE_NODES = ast.Tuple | ast.List | ast.Set
NOT_MUTATED = {"__slots__", "__all__"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Mutant:
    """Changed statement; ``scope`` is its function, "" at module level; ``statement`` is the line of its statement."""

    line: int
    statement: int
    scope: str
    kind: str
    before: str
    after: str
    at_load: bool
    """Whether it acts while the module is loaded: a table, a default, a field of a class."""
    place: tuple[Any, str, int | None, ast.AST]
    """Parent, field, index, and the new node."""

    def description(self) -> str:
        return f"{self.before} → {self.after}"


def apply(mutant: Mutant) -> None:
    """Change the tree of the mutant in place."""
    parent, name, index, new = mutant.place
    if index is None:
        setattr(parent, name, new)
    else:
        getattr(parent, name)[index] = new


@dataclass(frozen=True, slots=True)
class _MutationScope:
    scope: str
    statement: int
    inside: bool
    """Whether the node is in a function."""
    excluded: bool = False
    """Whether text is left unchanged."""


def mutants(tree: ast.Module) -> list[Mutant]:
    """Return every mutant of a module, in source order."""
    return list(_walk(tree, _MutationScope("", 0, False)))


def _walk(parent: ast.AST, at: _MutationScope) -> Iterator[Mutant]:
    for name, index, node in _children(parent):
        here = _inner(node, at)
        if here is None:
            continue
        for kind, new in _changes(parent, node, here):
            ast.copy_location(new, node)
            ast.fix_missing_locations(new)
            yield Mutant(
                line=getattr(node, "lineno", here.statement),
                statement=here.statement,
                scope=here.scope,
                kind=kind,
                before=_source_text(node),
                after=_source_text(new),
                at_load=not here.inside or isinstance(parent, ast.arguments),
                place=(parent, name, index, new),
            )
        yield from _walk(node, here)


def _children(parent: ast.AST) -> Iterator[tuple[str, int | None, Any]]:
    for name, value in ast.iter_fields(parent):
        if name in ("annotation", "returns", "decorator_list", "bases", "type_params", "pattern", "names"):
            continue
        if isinstance(value, ast.AST):
            yield name, None, value
        elif isinstance(value, list):
            yield from ((name, index, node) for index, node in enumerate(value) if isinstance(node, ast.AST))


def _inner(node: ast.AST, at: _MutationScope) -> _MutationScope | None:
    """Return the scope inside a node; None: the node is left unchanged."""
    if isinstance(node, ast.Import | ast.ImportFrom | ast.Assert | ast.FormattedValue) or _is_docstring(node):
        return None
    if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
        return None
    if isinstance(node, ast.Assign | ast.AnnAssign) and not at.inside and _is_typing(node):
        return None
    scope, inside = at.scope, at.inside
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        scope = f"{scope}.{node.name}".lstrip(".")
        inside = inside or not isinstance(node, ast.ClassDef)
    statement = node.lineno if isinstance(node, ast.stmt) else at.statement
    hushed = at.excluded or (isinstance(node, ast.Raise) and "ValueError" in ast.dump(node))
    return _MutationScope(scope, statement, inside, hushed)


def _is_docstring(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def _is_typing(node: ast.Assign | ast.AnnAssign) -> bool:
    targets = node.targets if isinstance(node, ast.Assign) else [node.target]
    if any(isinstance(target, ast.Name) and target.id in NOT_MUTATED for target in targets):
        return True
    value = node.value
    union = isinstance(value, ast.BinOp) and isinstance(value.op, ast.BitOr) and _is_type(value)
    return union or (isinstance(value, ast.Subscript) and isinstance(value.value, ast.Name | ast.Attribute))


def _is_type(node: ast.AST) -> bool:
    """Return whether this is a union of types, not of sets or numbers."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.BitOr):
        return _is_type(node.left) and _is_type(node.right)
    return isinstance(node, ast.Name) and node.id[0].isupper() and not node.id.isupper()


def _source_text(node: ast.AST) -> str:
    text = " ".join(ast.unparse(node).split())
    return text if len(text) <= 90 else text[:87] + "..."


def _changes(parent: ast.AST, node: ast.AST, at: _MutationScope) -> Iterator[tuple[str, Any]]:
    match node:
        case ast.Compare():
            yield from _compared(node)
        case ast.BoolOp(op=op, values=values):
            yield "and/or", ast.BoolOp(ast.Or() if isinstance(op, ast.And) else ast.And(), values)
            for index in range(len(values)):
                rest = values[:index] + values[index + 1 :]
                yield "condition dropped", rest[0] if len(rest) == 1 else ast.BoolOp(op, rest)
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            yield "not dropped", operand
        case ast.UnaryOp(op=ast.USub(), operand=operand) if not isinstance(operand, ast.Constant):
            yield "arithmetic", operand
        case ast.BinOp(left=left, op=op, right=right):
            yield from _arithmetic_changes(left, op, right)
        case ast.Constant(value=value):
            yield from (("constant", ast.Constant(other)) for other in _others(value, at))
        case ast.IfExp(test=test, body=body, orelse=orelse):
            yield "branches swapped", ast.IfExp(test, orelse, body)
        case ast.Call(func=ast.Name(id=name)) if name in SWAPPED_NAMES:
            yield "twin", ast.Call(ast.Name(SWAPPED_NAMES[name], ast.Load()), node.args, node.keywords)
        case ast.Call(func=ast.Attribute(value=value, attr=name)) if name in SWAPPED_NAMES:
            yield "twin", ast.Call(ast.Attribute(value, SWAPPED_NAMES[name], ast.Load()), node.args, node.keywords)
        case ast.Slice(lower=lower, upper=upper):
            yield from _cut(lower, upper)
        case ast.Dict() if not at.inside:
            yield from _dict(node)
        case ast.Tuple() | ast.List() | ast.Set() if _is_table(parent, node, at):
            for index in range(len(node.elts)):
                yield "entry dropped", type(node)(elts=node.elts[:index] + node.elts[index + 1 :], ctx=ast.Load())
        case ast.comprehension(ifs=[_, *_]):
            yield "filter dropped", ast.comprehension(node.target, node.iter, [], node.is_async)
        case ast.ExceptHandler():
            yield "raised again", ast.ExceptHandler(node.type, node.name, [ast.Raise()])
        case ast.If(test=test) | ast.While(test=test) if not isinstance(test, ast.Compare | ast.BoolOp | ast.UnaryOp):
            test = ast.copy_location(ast.UnaryOp(ast.Not(), test), test)
            yield "negated", type(node)(test=test, body=node.body, orelse=node.orelse)
        case ast.stmt():
            yield from _statement(node)


def _compared(node: ast.Compare) -> Iterator[tuple[str, ast.AST]]:
    for index, op in enumerate(node.ops):
        for new in COMPARE[type(op)]:
            yield (
                "comparison",
                ast.Compare(node.left, [*node.ops[:index], new(), *node.ops[index + 1 :]], node.comparators),
            )


def _arithmetic_changes(left: ast.expr, op: ast.operator, right: ast.expr) -> Iterator[tuple[str, ast.AST]]:
    if isinstance(op, ast.BitOr) and _is_type(left) and _is_type(right):
        yield from (("type dropped", side) for side in (left, right))
    elif not (isinstance(left, ast.Constant) and isinstance(left.value, str | bytes)):
        yield "arithmetic", ast.BinOp(left, SWAPPED_OPERATORS[type(op)](), right)


def _others(value: Any, at: _MutationScope) -> Iterator[Any]:
    match value:
        case bool():
            yield not value
        case int():
            yield from (value + 1, value - 1)
        case float():
            yield from (value * 1.5, value * 0.5) if value else (1.0,)
        case str() if value and not at.excluded:
            yield value + "x"
        case bytes() if value:
            yield from (value[1:], value[:-1]) if len(value) > 1 else (b"",)


def _cut(lower: ast.expr | None, upper: ast.expr | None) -> Iterator[tuple[str, ast.AST]]:
    if lower is not None and not isinstance(lower, ast.Constant):
        yield "bound dropped", ast.Slice(None, upper)
    if upper is not None and not isinstance(upper, ast.Constant):
        yield "bound dropped", ast.Slice(lower, None)


def _dict(node: ast.Dict) -> Iterator[tuple[str, ast.AST]]:
    for index in range(len(node.keys)):
        yield (
            "entry dropped",
            ast.Dict(node.keys[:index] + node.keys[index + 1 :], node.values[:index] + node.values[index + 1 :]),
        )
        other = node.values[(index + 1) % len(node.values)]
        if ast.dump(other) != ast.dump(node.values[index]):
            yield (
                "value of its neighbour",
                ast.Dict(node.keys, [*node.values[:index], other, *node.values[index + 1 :]]),
            )


def _is_table(parent: ast.AST, node: ast.Tuple | ast.List | ast.Set, at: _MutationScope) -> bool:
    if isinstance(parent, ast.Subscript) or not node.elts or isinstance(getattr(node, "ctx", None), ast.Store):
        return False
    return isinstance(parent, ast.Compare) or not at.inside


def _statement(node: ast.stmt) -> Iterator[tuple[str, ast.AST]]:
    match node:
        case ast.Return(value=value) if value is not None and not (
            isinstance(value, ast.Constant) and value.value is None
        ):
            yield "returns None", ast.Return(ast.Constant(None))
        case ast.Expr() | ast.AugAssign() | ast.Raise() | ast.Delete() | ast.Break():
            yield "statement dropped", ast.Pass()
        case ast.Assign(targets=[ast.Attribute() | ast.Subscript()]):
            yield "statement dropped", ast.Pass()
        case ast.Continue():
            yield "statement dropped", ast.Break()
    if isinstance(node, ast.AugAssign):
        yield "arithmetic", ast.AugAssign(node.target, SWAPPED_OPERATORS[type(node.op)](), node.value)
