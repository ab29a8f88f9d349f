"""How a verb speaks: in which language, as sentences or as JSON, and to which stream."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from contextvars import ContextVar
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import click

from drivebus import i18n


@dataclass(slots=True)
class OutputSettings:
    """What ``--lang`` and ``--json`` ask for."""

    language: str
    as_json: bool = False


_settings: ContextVar[OutputSettings | None] = ContextVar("drivebus_voice", default=None)


def parse_global_options(arguments: list[str]) -> OutputSettings:
    """Find ``--lang`` and ``--json`` wherever they stand, before anything is parsed: ``--help`` and a wrong option
    must already speak the right language."""
    voice = OutputSettings(i18n.preferred())
    own = arguments[: arguments.index("--")] if "--" in arguments else arguments
    for index, argument in enumerate(own):
        name, _, value = argument.partition("=")
        if name == "--lang":
            wanted = value or (own[index + 1] if index + 1 < len(own) else "")
            voice.language = wanted if wanted in i18n.LANGUAGES else voice.language
        voice.as_json = voice.as_json or argument == "--json"
    _settings.set(voice)
    return voice


def current_settings() -> OutputSettings:
    """The voice of this invocation; the user's own language outside one."""
    return _settings.get() or OutputSettings(i18n.preferred())


def language() -> str:
    return current_settings().language


def as_json() -> bool:
    return current_settings().as_json


def text(key: str, /, **params: Any) -> str:
    """The sentence for ``key`` in the user's language."""
    return i18n.text(key, language(), **params)


def print_message(key: str, /, **params: Any) -> None:
    """A sentence on standard output; nothing where JSON was asked for."""
    if not as_json():
        click.echo(wrap_for(text(key, **params), sys.stdout))


def print_note(key: str, /, **params: Any) -> None:
    """A sentence beside the result, on standard error: progress, warnings, what happens next."""
    click.echo(wrap_for(text(key, **params), sys.stderr), err=True)


def print_text(text: str) -> None:
    """Ready text on standard output; nothing where JSON was asked for."""
    if not as_json():
        click.echo(text)


def join_sentences(said: Sequence[str]) -> str:
    """One after the other: Chinese puts no blank between them."""
    return ("" if language() == "zh" else " ").join(said)


def wrap_for(text: str, stream: Any, indent: int = 0) -> str:
    """Broken at words where ``stream`` is a terminal, on as many cells as it has; else left whole."""
    if not (hasattr(stream, "isatty") and stream.isatty()):
        return " " * indent + text
    from drivebus.cli.text_layout import wrap

    cells = terminal_width(stream) - indent
    return "\n".join(" " * indent + part for line in text.split("\n") for part in wrap(line, max(20, cells)))


def terminal_width(stream: Any) -> int:
    """Cells of a line of ``stream``; without end where it is no terminal."""
    import shutil

    on_terminal = hasattr(stream, "isatty") and stream.isatty()
    return shutil.get_terminal_size().columns - 1 if on_terminal else 10_000


def fitted_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table no wider than the terminal."""
    from drivebus.cli.text_layout import table

    return table(head, rows, terminal_width(sys.stdout))


def print_json(value: Any, *, stream: bool = False) -> None:
    """One JSON document where it was asked for; ``stream`` puts it on one line."""
    if as_json():
        click.echo(json.dumps(value, ensure_ascii=False, indent=None if stream else 2, default=to_json_value))


def to_json_value(value: Any) -> Any:
    """JSON form of what the library hands out: bytes as spaced hex, enums by value, texts in the user's language."""
    if isinstance(value, bytes | bytearray):
        return bytes(value).hex(" ").upper()
    if hasattr(value, "en") and hasattr(value, "zh"):
        return getattr(value, language())
    if isinstance(value, set | frozenset):
        return sorted(value)
    if is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in fields(value)}
    return getattr(value, "value", None) if hasattr(value, "value") else str(value)
