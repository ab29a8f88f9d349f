"""Language and format of the output, found in the arguments before click parses them, or where it is not installed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from drivebus import i18n


@dataclass(slots=True)
class OutputSettings:
    """Values of ``--lang`` and ``--json``."""

    language: str
    as_json: bool = False


def output_settings(arguments: Sequence[str]) -> OutputSettings:
    """Return the values of ``--lang`` and ``--json`` anywhere before ``--``; without them text in the user's language.

    The texts of ``--help`` and of usage errors depend on them.
    """
    settings = OutputSettings(i18n.preferred())
    own = arguments[: arguments.index("--")] if "--" in arguments else arguments
    for index, argument in enumerate(own):
        name, _, value = argument.partition("=")
        if name == "--lang":
            language = value or (own[index + 1] if index + 1 < len(own) else "")
            settings.language = language if language in i18n.LANGUAGES else settings.language
        settings.as_json = settings.as_json or argument == "--json"
    return settings
