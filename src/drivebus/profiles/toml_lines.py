"""Where a key stands in a TOML text. Used only when something is wrong: ``tomllib`` keeps no positions.

It reads valid TOML just well enough to follow tables, keys and values over lines; it decides nothing about values.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

KeyPath = tuple[str, ...]

_KEY = r"""(?:[A-Za-z0-9_\-]+|"(?:[^"\\]|\\.)*"|'[^']*')"""
_DOTTED = rf"{_KEY}(?:\s*\.\s*{_KEY})*"
_TABLE = re.compile(rf"\s*\[\s*({_DOTTED})\s*\]")
_ARRAY = re.compile(rf"\s*\[\[\s*({_DOTTED})\s*\]\]")
_ASSIGN = re.compile(rf"\s*({_DOTTED})\s*=\s*")
_INLINE = re.compile(rf"[{{,]\s*({_DOTTED})\s*=")
_PART = re.compile(_KEY)
_STRING = re.compile(r'"""(?:[^\\]|\\.)*?"""|\'\'\'.*?\'\'\'|"(?:[^"\\\n]|\\.)*"|\'[^\'\n]*\'|#[^\n]*', re.DOTALL)


def line_of(text: str, path: Sequence[str | int]) -> int | None:
    """The 1-based line of the key, or of its nearest parent; None where not even that is in the text."""
    wanted = tuple(str(part) for part in path)
    best: tuple[int, int] | None = None
    for found, line in iter_keys(text):
        depth = len(found)
        if found == wanted[:depth] and (best is None or depth > best[0]):
            best = (depth, line)
    return best[1] if best else None


def has_key(text: str, path: Sequence[str | int]) -> bool:
    """Whether the key itself, not only a parent, stands in the text."""
    wanted = tuple(str(part) for part in path)
    return any(found == wanted for found, _ in iter_keys(text))


def iter_keys(text: str) -> Iterator[tuple[KeyPath, int]]:
    """Every key of the text with its line, in order; arrays of tables carry their index."""
    blank = _STRING.sub(_blank_match, text)
    table: KeyPath = ()
    counts: dict[KeyPath, int] = {}
    depth = 0
    for number, (line, masked) in enumerate(zip(text.split("\n"), blank.split("\n"), strict=True), 1):
        if depth > 0:
            depth += _nesting(masked)
            continue
        bracket = masked.lstrip().startswith("[")
        array, header = (_ARRAY.match(line), _TABLE.match(line)) if bracket else (None, None)
        assign = _ASSIGN.match(line) if "=" in masked else None
        if array:
            name = _split_key(array[1])
            counts[name] = counts.get(name, -1) + 1
            table = (*name, str(counts[name]))
            yield table, number
        elif header:
            table = _split_key(header[1])
            yield table, number
        elif assign:
            key = table + _split_key(assign[1])
            yield key, number
            for inner in _INLINE.finditer(line, assign.end()):
                if masked[inner.end() - 1] == "=":
                    yield key + _split_key(inner[1]), number
            depth = max(0, _nesting(masked[assign.end() :]))


def _split_key(dotted: str) -> KeyPath:
    return tuple(part.strip("\"'") for part in _PART.findall(dotted))


def _nesting(masked: str) -> int:
    """How many brackets the line leaves open; strings and comments are already blanked."""
    return sum(masked.count(char) for char in "[{") - sum(masked.count(char) for char in "]}")


def _blank_match(match: re.Match[str]) -> str:
    """Strings keep their place and their newlines, so that brackets and keys in them count for nothing."""
    mark = " " if match[0].startswith("#") else "s"
    return re.sub(r"[^\n]", mark, match[0])
