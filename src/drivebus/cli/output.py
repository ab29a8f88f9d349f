"""Terminal output of the commands: language, text or JSON, wrapping, tables, progress bar."""

from __future__ import annotations

import json
import os
import re
import sys
import unicodedata
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import fields, is_dataclass
from typing import Any

import click

from drivebus import i18n
from drivebus.cli.background_output import background_stream
from drivebus.cli.output_settings import OutputSettings, output_settings
from drivebus.control_characters import CONTROL_CHARACTERS, without_control_characters
from drivebus.errors import SystemReason
from drivebus.terminal import discard_output

_UNLIMITED_CELLS = 10_000  # width of an output that is no terminal
_MAX_PAGE_CELLS = 98  # lines of text are no longer, however wide the terminal is
_MAX_TERM_CELLS = 26  # a longer term of a definition list stands on a line of its own
_MIN_WRAP_CELLS = 20  # a narrower terminal is treated as one of this width
_MIN_LAST_COLUMN_CELLS = 20  # with less space, the last column of a table goes to its own lines
_WIDE = "\u2e80-\u9fff\uff00-\uffef\u3000-\u303f"
_OPENING = "（「“《"
_CLOSING = "，。；：、！？）」”》…"
_URL = rf"[a-z0-9]+://[^\s{_OPENING}{_CLOSING}]*"  # also with placeholders in Chinese
_BREAKABLE_PIECE = re.compile(rf"\s+|[{_OPENING}]*(?:{_URL}|[^\s{_WIDE}“]+|[{_WIDE}“])[{_CLOSING}]*")


# --- settings of an invocation ------------------------------------------------------------------------------------


_settings: ContextVar[OutputSettings | None] = ContextVar("drivebus_output", default=None)


def parse_global_options(arguments: list[str]) -> OutputSettings:
    """Use ``--lang`` and ``--json`` of the arguments for the output of this invocation."""
    settings = output_settings(arguments)
    _settings.set(settings)
    return settings


def current_settings() -> OutputSettings:
    """Return the settings of this invocation; outside one, text in the language of the locale."""
    return _settings.get() or OutputSettings(i18n.preferred())


def language() -> str:
    return current_settings().language


def file_language() -> str:
    """Return the language of the files that a command writes: their encoding is UTF-8, whatever that of the output."""
    return "zh" if current_settings().encoding_without_chinese else language()


def export_language() -> None:
    """Use the language also for the log of a service and for the processes of its gateways."""
    if language() != i18n.preferred():
        os.environ[i18n.LANGUAGE_VARIABLE] = language()


def as_json() -> bool:
    return current_settings().as_json


def text(key: str, /, **params: Any) -> str:
    """Return the sentence of a catalogue key in the user's language."""
    return i18n.text(key, language(), **params)


# --- printing -----------------------------------------------------------------------------------------------------

_continues: ContextVar[bool] = ContextVar("drivebus_continues_without_output", default=False)


@contextmanager
def continue_without_output() -> Iterator[None]:
    """Let the block go on where its output can't be written: a full disk or a closed pipe must not prevent a stop."""
    before = _continues.set(True)
    try:
        yield
    finally:
        _continues.reset(before)


def echo(ready: str, *, err: bool = False, nl: bool = True, controls: bool = False) -> None:
    """Print a text on standard output or ``err``. Raises OSError, but not in ``continue_without_output``.

    Control characters but tabs and line breaks come from a file, a device or a service and are replaced, except in a
    text that ``controls`` the terminal by its own.
    """
    if not controls:
        ready = without_control_characters(ready, keep="\n\t")
    stream = sys.stderr if err else sys.stdout
    try:
        if (background := background_stream(stream)) is not None:
            background.write(ready + "\n" * nl)
        else:
            click.echo(ready, err=err, nl=nl)
    except OSError as error:
        if not _continues.get():
            raise
        discard_output(stream)
        if not err:
            print_note("cli.output_lost", reason=SystemReason(error))


def print_message(key: str, /, **params: Any) -> None:
    """Print a sentence on standard output; nothing with ``--json``."""
    if not as_json():
        echo(wrap_for(text(key, **params), sys.stdout))


def print_note(key: str, /, **params: Any) -> None:
    """Print a sentence on standard error: progress, warnings, hints."""
    echo(wrap_for(text(key, **params), sys.stderr), err=True)


def print_text(ready: str) -> None:
    """Print a text on standard output as it is; nothing with ``--json``."""
    if not as_json():
        echo(ready)


def print_wrapped(ready: str, indent: int = 0) -> None:
    """Print a text on standard output, wrapped at the width of its terminal; nothing with ``--json``."""
    print_text(wrap_for(ready, sys.stdout, indent))


def is_blocked() -> bool:
    """Return whether the reader of standard output does not read, so that further output would only wait."""
    background = background_stream(sys.stdout)
    return background is not None and background.is_blocked


def end_live_line() -> None:
    """End the line of a terminal that an attached command draws again and again, or that shows ^C."""
    if sys.stdout.isatty():
        print_text("")


def print_json(value: Any, *, stream: bool = False) -> None:
    """Print a JSON document with ``--json``; ``stream`` puts it on one line."""
    if as_json():
        document = json.dumps(value, ensure_ascii=False, indent=None if stream else 2, default=to_json_value)
        echo(CONTROL_CHARACTERS.sub(_json_escape, document))


def _json_escape(found: re.Match[str]) -> str:
    """Return a control character as JSON has it within a string; the line breaks between members stay."""
    return "\n" if found[0] == "\n" else f"\\u{ord(found[0]):04x}"


def to_json_value(value: Any) -> Any:
    """Convert a library value to JSON: bytes as spaced hex, enums by value, texts in the user's language."""
    if isinstance(value, bytes | bytearray):
        return bytes(value).hex(" ").upper()
    if hasattr(value, "en") and hasattr(value, "zh"):
        return getattr(value, language())
    if isinstance(value, set | frozenset):
        return sorted(value)
    if is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in fields(value)}
    return value.value if hasattr(value, "value") else str(value)


def join(parts: Iterable[str], kind: i18n.ListParts) -> str:
    """Return the parts of a list as one text in the user's language."""
    return i18n.join(parts, kind, language())


# --- width and wrapping -------------------------------------------------------------------------------------------


def terminal_width(stream: Any) -> int:
    """Return the cells of a line of ``stream``; unlimited if it is no terminal."""
    import shutil

    on_terminal = hasattr(stream, "isatty") and stream.isatty()
    return shutil.get_terminal_size().columns - 1 if on_terminal else _UNLIMITED_CELLS


def page_cells() -> int:
    """Return the cells of a line of a page on standard output, short enough to read."""
    return min(_MAX_PAGE_CELLS, terminal_width(sys.stdout))


def width(string: str) -> int:
    """Return the terminal cells of ``string``; a Chinese character has two."""
    return sum(2 if unicodedata.east_asian_width(c) in "WF" else 0 if unicodedata.combining(c) else 1 for c in string)


def pad(string: str, cells: int) -> str:
    """Fill ``string`` with blanks up to ``cells``; a longer one stays whole."""
    return string + " " * max(0, cells - width(string))


def wrap(string: str, cells: int) -> list[str]:
    """Break into lines of at most ``cells``.

    Chinese breaks anywhere but in a URL, next to brackets and before punctuation.
    """
    lines: list[str] = []
    line = ""
    for piece in _BREAKABLE_PIECE.findall(string):
        if line and width(line) + width(piece.rstrip()) > cells:
            lines.append(line.rstrip())
            line = ""
        line += piece if line else piece.lstrip()
    return [*lines, line.rstrip()] if line.strip() else lines


def wrap_for(string: str, stream: Any, indent: int = 0) -> str:
    """Wrap at the width of the terminal; an output that is no terminal gets whole lines."""
    if not (hasattr(stream, "isatty") and stream.isatty()):
        return " " * indent + string
    cells = max(_MIN_WRAP_CELLS, terminal_width(stream) - indent)
    return "\n".join(" " * indent + part for line in string.split("\n") for part in wrap(line, cells))


def paragraphs(string: str, cells: int, indent: int = 2) -> str:
    """Wrap and indent paragraphs; a line that begins with two blanks stays as it is."""
    blank = " " * indent
    shown: list[str] = []
    for line in string.split("\n"):
        verbatim = line.startswith("  ") or not line
        shown += [blank + line if line else ""] if verbatim else [blank + part for part in wrap(line, cells - indent)]
    return "\n".join(shown)


# --- tables -------------------------------------------------------------------------------------------------------


def two_columns(rows: Sequence[tuple[str, str]], cells: int, indent: int = 2) -> str:
    """Format a definition list: terms on the left, explanations wrapped on the right."""
    left = min(max((width(term) for term, _ in rows), default=0), _MAX_TERM_CELLS) + 2
    shown: list[str] = []
    for term, meaning in rows:
        lines = wrap(meaning, cells - indent - left) or [""]
        if width(term) + 2 > left:
            shown.append(" " * indent + term)
        else:
            shown.append((" " * indent + pad(term, left) + lines.pop(0)).rstrip())
        shown += [" " * (indent + left) + line for line in lines]
    return "\n".join(shown)


def table(head: Sequence[str], rows: Sequence[Sequence[str]], cells: int = _UNLIMITED_CELLS) -> str:
    """Format a table whose columns are as wide as their widest cell.

    The last column is wrapped to end within ``cells``, on lines of its own if little space is left beside the others.
    So are further columns from the right, as long as the rest does not fit beside each other; below each other they
    stand in columns too where these fit.
    """
    widths = [max(width(row[index]) for row in [head, *rows]) for index in range(len(head))]
    left = sum(widths[:-1]) + 2 * (len(head) - 1)
    beside = cells - left >= min(_MIN_LAST_COLUMN_CELLS, widths[-1])
    lead = len(head) - 1
    while lead > 1 and sum(widths[:lead]) + 2 * (lead - 1) > cells:
        lead -= 1
    folds_columns = not beside and lead < len(head) - 1
    folded = sum(widths[lead:-1]) + 2 * (len(head) - 1 - lead) + min(_MIN_LAST_COLUMN_CELLS, widths[-1])
    aligns_folded = folds_columns and folded <= cells - 4

    def cells_of(row: Sequence[str], start: int, end: int) -> str:
        return "  ".join(pad(row[index], widths[index]) for index in range(start, end))

    shown: list[str] = []
    for row in [head, *rows] if beside or folds_columns else rows:
        if folds_columns and not aligns_folded:
            last = fill_lines(row[lead:], cells - 4)
        else:
            rest = "  ".join([cells_of(row, lead, len(head) - 1), row[-1]]) if folds_columns else row[-1]
            last = wrap(rest, cells - (left if beside else 4))
        shown.append(f"{cells_of(row, 0, lead)}  {last.pop(0) if last and beside else ''}".rstrip())
        shown += [" " * (left if beside else 4) + line for line in last]
    return "\n".join(shown if beside or folds_columns else [cells_of(head, 0, lead).rstrip(), *shown])


def fill_lines(row: Sequence[str], cells: int) -> list[str]:
    """Return lines with as many values of a row as fit beside each other; only one longer than a line is broken."""
    lines: list[str] = []
    for value in filter(None, row):
        joined = f"{lines[-1]}  {value}" if lines else value
        if width(joined) <= cells:
            lines[-1:] = [joined]
        elif width(value) <= cells:
            lines.append(value)
        else:
            lines[-1:] = wrap(joined, cells)
    return lines


def fitted_table(head: Sequence[str], rows: Sequence[Sequence[str]], stream: Any = None) -> str:
    """Format a table no wider than the terminal of ``stream``, else of standard output."""
    return table(head, rows, terminal_width(stream or sys.stdout))


# --- progress -----------------------------------------------------------------------------------------------------


class ProgressBar:
    """Progress bar on standard error with a description and the remaining time; nothing if it is no terminal.

    A terminal that was closed is no error: the work goes on.
    """

    def __init__(self) -> None:
        self._bar: Any = None
        self._task: Any = None

    def __enter__(self) -> ProgressBar:
        if sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn

            columns = (TextColumn("{task.description}"), BarColumn(bar_width=None), TextColumn("{task.fields[left]}"))
            self._bar = Progress(*columns, console=Console(stderr=True), transient=True)
            self._task = self._bar.add_task("", total=1.0, left="")
            with suppress(OSError):
                self._bar.start()
        return self

    def __exit__(self, *exc: object) -> None:
        if self._bar is not None:
            with suppress(OSError):
                self._bar.stop()

    def update(self, description: str, done: float, total: float) -> None:
        """Show ``done`` of ``total`` seconds."""
        if self._bar is not None:
            left = text("scan.left", time=format_minutes(max(0.0, total - done)))
            self._bar.update(self._task, description=description, total=total, completed=done, left=left)

    def print_above(self, line: str) -> None:
        """Print a line above the bar."""
        if self._bar is not None:
            with suppress(OSError):
                self._bar.console.print(line, markup=False, highlight=False)


def format_minutes(seconds: float) -> str:
    """Format a time as ``3:07``."""
    whole = int(seconds + 0.5)
    return f"{whole // 60}:{whole % 60:02d}"


def format_duration(seconds: float) -> str:
    """Format a duration as ``31 min 50 s`` or ``2 s``; at least 1 s."""
    minutes, rest = divmod(max(1, int(seconds + 0.5)), 60)
    return text("scan.long" if minutes else "scan.short", minutes=minutes, seconds=rest)
