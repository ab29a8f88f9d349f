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

Path = tuple[str | int, ...]
CONTROL = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]")
"""Control characters, line separators, and those that turn the direction of writing round."""
ROOM = "profiles"
"""The room of the catalogues whose sentences every file's faults may use."""


@dataclass(frozen=True, slots=True)
class Complaint:
    """One fault of one file. ``kind`` is the i18n key of its sentence, ``<room>.kind.<kind>``."""

    kind: str
    key: str
    """Dotted, as it would be written: ``signals.output_frequency.unit``; empty for the whole file."""
    found: str
    expected: Text
    remedy: Text
    file: str = ""
    line: int | None = None
    room: str = ROOM
    """Whose sentences they are: a kind that it lacks is said in this room's words."""

    def text(self, language: str = "en") -> str:
        """The whole sentence: where, what was found, what was expected, what to do."""
        return plain(
            "profiles.complaint",
            language,
            where=self._where(language),
            what=i18n.text(_key(self.room, "kind", self.kind), language),
            found=self.found,
            expected=self.expected,
            remedy=self.remedy,
        )

    def _where(self, language: str) -> str:
        """File, line and key, as far as it has them."""
        place = self.file if self.line is None else f"{self.file}:{self.line}"
        return i18n.text("profiles.where", language, place=place, key=self.key) if self.key else place


def plain(key: str, language: str, /, **params: Any) -> str:
    """A sentence without control characters: a file may have them, a log or a terminal must not get them (S13)."""
    return CONTROL.sub("�", i18n.text(key, language, **params))


@dataclass(frozen=True, slots=True)
class Problem:
    """A complaint that does not know yet where its key stands."""

    kind: str
    path: Path
    found: Any
    params: dict[str, Any]
    """Places of the sentences ``<room>.expected.<kind>`` and ``<room>.remedy.<kind>``."""
    also: tuple[Path, ...] = ()
    """Other keys that have a part in it: where only one of them stands in the user's file, that one is named."""


def problem(
    kind: str, path: Sequence[str | int], found: Any, /, *, also: Sequence[Path] = (), **params: Any
) -> Problem:
    return Problem(kind, tuple(path), found, params, tuple(also))


def complain(found: Problem, file: str, line: int | None, room: str = ROOM) -> Complaint:
    """The complaint, with its sentences in both languages."""
    return Complaint(
        found.kind,
        dotted(found.path),
        shown(found.found),
        both(_key(room, "expected", found.kind), **found.params),
        both(_key(room, "remedy", found.kind), **found.params),
        file,
        line,
        room,
    )


def _key(room: str, part: str, kind: str) -> str:
    own = f"{room}.{part}.{kind}"
    return own if i18n.known(own) else f"{ROOM}.{part}.{kind}"


def refusal(complaints: Sequence[Complaint]) -> ProfileError:
    """The error for a profile with these faults."""
    return ProfileError("profiles.refused", **facts(complaints))


def facts(complaints: Sequence[Complaint]) -> dict[str, Any]:
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


def both(key: str, /, **params: Any) -> Text:
    """A sentence of the catalogues in both languages."""
    return Text(i18n.text(key, "en", **params), i18n.text(key, "zh", **params))


def dotted(path: Sequence[str | int]) -> str:
    """A path as TOML writes it: parts that are no bare key are quoted."""
    return ".".join(_quoted(str(part)) for part in path)


def _quoted(part: str) -> str:
    bare = part.isascii() and part.replace("_", "").replace("-", "").isalnum()
    return part if bare else f'"{part}"'


def shown(value: Any) -> str:
    """A TOML value as one would write it; of a long one its two ends."""
    if value is None:
        text = "-"
    elif isinstance(value, bool):
        text = str(value).lower()
    elif isinstance(value, str):
        text = f'"{value}"'
    else:
        text = str(value)
    return cut(text)


def cut(text: str) -> str:
    """At most 60 characters: what lies in the middle of a longer one is left out, for a path's name is at its end."""
    return text if len(text) <= 60 else f"{text[:28]}...{text[-29:]}"
