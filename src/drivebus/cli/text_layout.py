"""Columns and line breaks for terminals where a Chinese character takes two cells. Text in, text out."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence

_WIDE = "\u2e80-\u9fff\uff00-\uffef\u3000-\u303f"
_CLOSING = "，。；：、！？）」”》…"
_BREAKABLE_PIECE = re.compile(rf"\s+|[（「“《]*[{_WIDE}](?:[{_CLOSING}]*)|[^\s{_WIDE}]+[{_CLOSING}]*")


def width(text: str) -> int:
    """Terminal cells that ``text`` takes."""
    return sum(2 if unicodedata.east_asian_width(c) in "WF" else 0 if unicodedata.combining(c) else 1 for c in text)


def pad(text: str, cells: int) -> str:
    """``text`` filled with blanks up to so many cells; longer text is left whole."""
    return text + " " * max(0, cells - width(text))


def wrap(text: str, cells: int) -> list[str]:
    """Lines of at most ``cells``; Chinese may break anywhere but before closing punctuation."""
    lines: list[str] = []
    line = ""
    for piece in _BREAKABLE_PIECE.findall(text):
        if line and width(line) + width(piece.rstrip()) > cells:
            lines.append(line.rstrip())
            line = ""
        line += piece if line else piece.lstrip()
    return [*lines, line.rstrip()] if line.strip() else lines


def paragraphs(text: str, cells: int, indent: int = 2) -> str:
    """Blank-line separated paragraphs, wrapped and indented; a line that begins with two blanks stays as it is."""
    blank = " " * indent
    shown: list[str] = []
    for line in text.split("\n"):
        kept = line.startswith("  ") or not line
        shown += [blank + line if line else ""] if kept else [blank + part for part in wrap(line, cells - indent)]
    return "\n".join(shown)


def two_columns(rows: Sequence[tuple[str, str]], cells: int, indent: int = 2, widest: int = 26) -> str:
    """A definition list: terms on the left, explanations wrapped on the right."""
    left = min(max((width(term) for term, _ in rows), default=0), widest) + 2
    shown: list[str] = []
    for term, meaning in rows:
        lines = wrap(meaning, cells - indent - left) or [""]
        if width(term) + 2 > left:
            shown.append(" " * indent + term)
        else:
            shown.append((" " * indent + pad(term, left) + lines.pop(0)).rstrip())
        shown += [" " * (indent + left) + line for line in lines]
    return "\n".join(shown)


_MIN_LAST_COLUMN_CELLS = 20
"""A last column with less room than this goes to lines of its own."""


def table(head: Sequence[str], rows: Sequence[Sequence[str]], cells: int = 10_000) -> str:
    """A plain table whose columns are as wide as their widest cell; the last one is wrapped to end within ``cells``,
    below its row where little room is left beside it."""
    widths = [max(width(row[index]) for row in [head, *rows]) for index in range(len(head))]
    left = sum(widths[:-1]) + 2 * (len(head) - 1)
    beside = cells - left >= min(_MIN_LAST_COLUMN_CELLS, widths[-1])
    shown: list[str] = []
    for row in [head, *rows] if beside else rows:
        before = "  ".join(pad(cell, widths[index]) for index, cell in enumerate(row[:-1]))
        last = wrap(row[-1], cells - (left if beside else 4))
        shown.append(f"{before}  {last.pop(0) if last and beside else ''}".rstrip())
        shown += [" " * (left if beside else 4) + line for line in last]
    return "\n".join(shown if beside else [_short_head(head, widths), *shown])


def _short_head(head: Sequence[str], widths: Sequence[int]) -> str:
    return "  ".join(pad(cell, widths[index]) for index, cell in enumerate(head[:-1])).rstrip()
