"""Language and format of the output, found in the arguments before click parses them, or where it is not installed."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass

from drivebus import i18n

_CHINESE_SAMPLE = "变频器"  # simplified: Big5 has other characters


@dataclass(slots=True)
class OutputSettings:
    """Values of ``--lang`` and ``--json``."""

    language: str
    as_json: bool = False
    encoding_without_chinese: str = ""
    """Encoding of the output because of which the texts are English; JSON escapes what an encoding lacks."""


def output_settings(arguments: Sequence[str]) -> OutputSettings:
    """Return the values of ``--lang`` and ``--json`` anywhere before ``--``; without them text in the user's language.

    Chinese texts are English where the encoding of the output lacks their characters. The texts of ``--help`` and of
    usage errors depend on the settings too.
    """
    settings = OutputSettings(i18n.preferred())
    own = arguments[: arguments.index("--")] if "--" in arguments else arguments
    for index, argument in enumerate(own):
        name, _, value = argument.partition("=")
        if name == "--lang":
            language = value or (own[index + 1] if index + 1 < len(own) else "")
            settings.language = language if language in i18n.LANGUAGES else settings.language
        settings.as_json = settings.as_json or argument == "--json"
    if settings.language == "zh" and not settings.as_json and (encoding := _encoding_without_chinese()):
        settings.language, settings.encoding_without_chinese = "en", encoding
    return settings


def _encoding_without_chinese() -> str:
    """Return the encoding of a standard stream that lacks Chinese characters; empty where none does."""
    for stream in (sys.stdout, sys.stderr):
        encoding = getattr(stream, "encoding", None) or "utf-8"
        try:
            _CHINESE_SAMPLE.encode(encoding)
        except UnicodeEncodeError:
            return encoding
    return ""
