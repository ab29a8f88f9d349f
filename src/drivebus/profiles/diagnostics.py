"""What is wrong with a TOML file: file, line, key, found, expected, remedy; and a profile's error that says so.

Other files than profiles (``plant.toml``) complain in the same form, with sentences of their own ``room``.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from drivebus import i18n
from drivebus.errors import ProfileError
from drivebus.profiles.model import Text

KeyPath = tuple[str | int, ...]
CONTROL_CHARACTERS = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]")
"""Control characters, line separators, and those that turn the direction of writing round."""
DEFAULT_CATALOGUE = "profiles"
"""The room of the catalogues whose sentences every file's faults may use."""


@dataclass(frozen=True, slots=True)
class Diagnostic:
    """One fault of one file. ``kind`` is the i18n key of its sentence, ``<room>.kind.<kind>``."""

    kind: str
    key: str
    """Dotted, as it would be written: ``signals.output_frequency.unit``; empty for the whole file."""
    found: str
    expected: Text
    remedy: Text
    file: str = ""
    line: int | None = None
    catalogue: str = DEFAULT_CATALOGUE
    """Whose sentences they are: a kind that it lacks is said in this room's words."""

    def text(self, language: str = "en") -> str:
        """The whole sentence: where, what was found, what was expected, what to do."""
        return printable_text(
            "profiles.complaint",
            language,
            where=self._location(language),
            what=i18n.text(_text_key(self.catalogue, "kind", self.kind), language),
            found=self.found,
            expected=self.expected,
            remedy=self.remedy,
        )

    def _location(self, language: str) -> str:
        """File, line and key, as far as it has them."""
        place = self.file if self.line is None else f"{self.file}:{self.line}"
        return i18n.text("profiles.where", language, place=place, key=self.key) if self.key else place


def printable_text(key: str, language: str, /, **params: Any) -> str:
    """A sentence without control characters: a file may have them, a log or a terminal must not get them (S13)."""
    return CONTROL_CHARACTERS.sub("�", i18n.text(key, language, **params))


@dataclass(frozen=True, slots=True)
class Issue:
    """A complaint that does not know yet where its key stands."""

    kind: str
    path: KeyPath
    found: Any
    params: dict[str, Any]
    """Places of the sentences ``<room>.expected.<kind>`` and ``<room>.remedy.<kind>``."""
    related: tuple[KeyPath, ...] = ()
    """Other keys that have a part in it: where only one of them stands in the user's file, that one is named."""


def issue(
    kind: str, path: Sequence[str | int], found: Any, /, *, related: Sequence[KeyPath] = (), **params: Any
) -> Issue:
    return Issue(kind, tuple(path), found, params, tuple(related))


def to_diagnostic(found: Issue, file: str, line: int | None, catalogue: str = DEFAULT_CATALOGUE) -> Diagnostic:
    """The complaint, with its sentences in both languages."""
    return Diagnostic(
        found.kind,
        dotted_key(found.path),
        format_value(found.found),
        bilingual_text(_text_key(catalogue, "expected", found.kind), **found.params),
        bilingual_text(_text_key(catalogue, "remedy", found.kind), **found.params),
        file,
        line,
        catalogue,
    )


def _text_key(room: str, part: str, kind: str) -> str:
    own = f"{room}.{part}.{kind}"
    return own if i18n.known(own) else f"{DEFAULT_CATALOGUE}.{part}.{kind}"


def profile_error(complaints: Sequence[Diagnostic]) -> ProfileError:
    """The error for a profile with these faults."""
    return ProfileError("profiles.refused", **error_params(complaints))


def error_params(complaints: Sequence[Diagnostic]) -> dict[str, Any]:
    """What a refusal carries: the facts of the first fault, and all ``complaints``."""
    first = complaints[0]
    everything = Text(*("\n".join(c.text(language) for c in complaints) for language in i18n.LANGUAGES))
    return {
        "file": first.file,
        "line": first.line,
        "key": first.key,
        "found": first.found,
        "expected": first.expected,
        "remedy": first.remedy,
        "count": len(complaints),
        "everything": everything,
        "complaints": tuple(complaints),
    }


def bilingual_text(key: str, /, **params: Any) -> Text:
    """A sentence of the catalogues in both languages."""
    return Text(i18n.text(key, "en", **params), i18n.text(key, "zh", **params))


def dotted_key(path: Sequence[str | int]) -> str:
    """A path as TOML writes it: parts that are no bare key are quoted."""
    return ".".join(_quote(str(part)) for part in path)


def _quote(part: str) -> str:
    bare = part.isascii() and part.replace("_", "").replace("-", "").isalnum()
    return part if bare else f'"{part}"'


def format_value(value: Any) -> str:
    """A TOML value as one would write it; of a long one its two ends."""
    if value is None:
        text = "-"
    elif isinstance(value, bool):
        text = str(value).lower()
    elif isinstance(value, str):
        text = f'"{value}"'
    else:
        text = str(value)
    return shorten(text)


def shorten(text: str) -> str:
    """At most 60 characters: what lies in the middle of a longer one is left out, for a path's name is at its end."""
    return text if len(text) <= 60 else f"{text[:28]}...{text[-29:]}"
