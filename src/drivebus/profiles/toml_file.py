"""TOML files of a user: decoding with diagnostics, and the line of each key.

``tomllib`` keeps no positions, so the lines are found by a second reader. It follows tables, keys and values of valid
TOML over lines and decides nothing about values.
"""

from __future__ import annotations

import codecs
import json
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

from drivebus.profiles.diagnostics import Issue, issue
from drivebus.user_input import half_width
from drivebus.values import bilingual_text

MAX_TOML_BYTES: Final = 1_000_000  # a profile or plant.toml has some kilobytes


TomlPath = tuple[str, ...]
"""Names of the tables and the key; an array of tables has its index as a name."""


_KEY = r"""(?:[A-Za-z0-9_\-]+|"(?:[^"\\]|\\.)*"|'[^']*')"""
_DOTTED = rf"{_KEY}(?:\s*\.\s*{_KEY})*"
_TABLE = re.compile(rf"\s*\[\s*({_DOTTED})\s*\]")
_ARRAY = re.compile(rf"\s*\[\[\s*({_DOTTED})\s*\]\]")
_BLANK_IN_TABLE = re.compile(rf"\s*(\[{{1,2}}\s*{_DOTTED}[ \t]+[\w\-][^\]]*\]{{1,2}})")
_ASSIGN = re.compile(rf"\s*({_DOTTED})\s*=\s*")
_INLINE = re.compile(rf"[{{,]\s*({_DOTTED})\s*=")
_PART = re.compile(_KEY)
_FIRST_WORD = re.compile(rf"""\s*(\[{{1,2}}{_DOTTED}\]{{0,2}}|"[^"]*"|'[^']*'|[^\s=:#"']+:?)""")
_STRING = re.compile(r'"""(?:[^\\]|\\.)*?"""|\'\'\'.*?\'\'\'|"(?:[^"\\\n]|\\.)*"|\'[^\'\n]*\'|#[^\n]*', re.DOTALL)


_LONG_INTEGER = re.compile(
    r"(?<![\w.+-])[+-]?(0x(_?[0-9A-Fa-f]){17,}|0o(_?[0-7]){23,}|0b(_?[01]){65,}|(_?[0-9]){20,})(?![\w.-]|[ \t]*=)"
)
"""Integer beyond the 64 bits of TOML. Python converts none of more than ``sys.int_info.default_max_str_digits``."""
_SYNTAX_FAULTS = (
    ("Expected '=' after a key", "equals"),
    ("Invalid value", "value"),
    ("Invalid statement", "statement"),
    ("Expected newline or end of document", "line_end"),
    ("Invalid initial character for a key", "key"),
    ("Cannot overwrite a value|Duplicate inline table key", "key_once"),
    ("Cannot declare .* twice|Cannot redefine|Cannot mutate", "table_once"),
    (r"Expected '\]\]'", "array_end"),
    (r"Expected '\]'", "table_end"),
    ("Unclosed array", "list_end"),
    ("Unclosed inline table", "inline_end"),
    (r"Unterminated string|Illegal character '\\[nr]|Expected \"", "quote"),
    (r"Unescaped '\\\\?' in a string|Invalid hex value|Escaped character", "backslash"),
    ("Illegal character", "character"),
    ("Invalid date", "date"),
)
"""Patterns of the messages of ``tomllib``, and of each the text ``profiles.toml.<name>`` of what is expected."""


class TomlFault(Exception):
    """Text that is no TOML file of a known format."""

    def __init__(self, fault: Issue, line: int | None) -> None:
        super().__init__(fault.kind)
        self.issue = fault
        self.line = line


def decode_toml(raw: bytes) -> tuple[str, dict[str, Any]]:
    """Return the text and the data of a file's bytes; a byte order mark is skipped.

    Raises TomlFault for size, encoding or syntax.
    """
    if len(raw) > MAX_TOML_BYTES:
        raise TomlFault(issue("too_large", (), len(raw), most=MAX_TOML_BYTES), 1)
    raw = raw.removeprefix(codecs.BOM_UTF8)
    try:
        text = raw.decode("utf-8").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise TomlFault(issue("encoding", (), f"{raw[error.start]:02X}H"), line) from None
    if _LONG_INTEGER.search(text) and (number := _LONG_INTEGER.search(_STRING.sub(_blank_match, text))):
        line, column = text.count("\n", 0, number.start()) + 1, number.start() - text.rfind("\n", 0, number.start())
        expected = bilingual_text("profiles.toml.number")
        word = _first_word(text.split("\n")[line - 1])
        raise TomlFault(issue("toml", (), word, column=column, expected=expected), line)
    try:
        return text, tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise syntax_fault(error, text) from None
    except RecursionError:
        expected = bilingual_text("profiles.toml.nesting")
        raise TomlFault(issue("toml", (), "[[[[", column=1, expected=expected), 1) from None


def syntax_fault(error: tomllib.TOMLDecodeError, text: str) -> TomlFault:
    """Return the fault at the line of a syntax error; at the last line where ``tomllib`` gives none.

    Of the line only its first word is shown: the value may be a password. Of a text without its closing quote only a
    full-width quote is the fault: other full-width characters may stand in a text.
    """
    at = re.search(r"line (\d+), column (\d+)", str(error))
    line = int(at[1]) if at else text.rstrip("\n").count("\n") + 1
    content = text.split("\n")[line - 1]
    if header := _BLANK_IN_TABLE.match(content):
        return TomlFault(issue("table_name_blank", (), header[1]), line)
    column = int(at[2]) if at else len(content) + 1
    message = str(error).split(" (at ")[0]
    name = next((name for pattern, name in _SYNTAX_FAULTS if re.match(pattern, message)), "other")
    outside = _STRING.sub(_blank_match, text).split("\n")[line - 1][:column]
    for place, (full, half) in enumerate(zip(outside, half_width(outside), strict=True), 1):
        if full != half and (name != "quote" or half in "\"'"):
            shown = bilingual_text("profiles.toml.space") if half == " " else half
            return TomlFault(issue("full_width", (), full, column=place, half=shown), line)
    expected = bilingual_text(f"profiles.toml.{name}", message=message)
    return TomlFault(issue("toml", (), _first_word(content), column=column, expected=expected), line)


def _first_word(line: str) -> str:
    """Return the key or the name of the table that the line begins with, or its first character."""
    match = _FIRST_WORD.match(line)
    return match[1] if match else line.strip()[:1]


def format_issue(data: Mapping[str, Any], newest: int) -> Issue | None:
    """Return the issue of a missing, unknown or newer ``format``."""
    version = data.get("format")
    if type(version) is int and 1 <= version <= newest:
        return None
    kind = "newer" if type(version) is int and version > newest else "format"
    return issue(kind, ("format",), version, newest=newest)


def line_of(text: str, path: Sequence[str | int]) -> int | None:
    """Return the 1-based line of the key or of its nearest parent; None where neither is in the text."""
    key_path = tuple(str(part) for part in path)
    best: tuple[int, int] | None = None
    for key, line in iter_keys(text):
        depth = len(key)
        if key == key_path[:depth] and (best is None or depth > best[0]):
            best = (depth, line)
    return best[1] if best else None


def has_key(text: str, path: Sequence[str | int]) -> bool:
    """Return whether the key itself, not only a parent, is in the text."""
    key_path = tuple(str(part) for part in path)
    return any(key == key_path for key, _ in iter_keys(text))


def iter_keys(text: str) -> Iterator[tuple[TomlPath, int]]:
    """Yield every key of the text with its line, in order."""
    blank = _STRING.sub(_blank_match, text)
    table: TomlPath = ()
    counts: dict[TomlPath, int] = {}
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


def _split_key(dotted: str) -> TomlPath:
    return tuple(part.strip("\"'") for part in _PART.findall(dotted))


def _nesting(masked: str) -> int:
    """Return the brackets that the line leaves open; strings and comments are blank already."""
    return sum(masked.count(char) for char in "[{") - sum(masked.count(char) for char in "]}")


def _blank_match(match: re.Match[str]) -> str:
    """Blank a string or comment; positions and newlines stay, brackets and keys in it go."""
    mark = " " if match[0].startswith("#") else "s"
    return re.sub(r"[^\n]", mark, match[0])


def toml_string(value: str) -> str:
    """Return a TOML string. JSON's escapes are TOML's, except for DEL."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
