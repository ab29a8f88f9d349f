"""Catalogues of every text that a user sees, in English and Chinese.

Catalogues are JSON files beside this module, ``<catalogue>.<language>.json``, each an object of key → text with
``{name}`` placeholders. No two catalogues share a key, and every language has the same keys (tested).
"""

from __future__ import annotations

import json
import locale
import os
import re
from collections.abc import Iterable
from functools import cache
from typing import Any, Literal

LANGUAGES = ("en", "zh")
LANGUAGE_VARIABLE = "DRIVEBUS_LANG"
"""Environment variable of the language of this process and its children."""
ListParts = Literal["items", "phrases", "clauses", "sentences"]
"""Kind of the parts of a list: Chinese puts another mark between names than between phrases."""

_FOLDERS = [os.path.dirname(__file__)]  # noqa: PTH120  importlib.resources alone costs a third of a bare click start


def add_folder(folder: str | os.PathLike[str]) -> None:
    """Add the catalogues of another package; its keys never replace existing ones."""
    path = os.fspath(folder)
    if path not in _FOLDERS:
        _FOLDERS.append(path)
        catalogue.cache_clear()
        catalogue_json.cache_clear()


@cache
def catalogue(language: str) -> dict[str, str]:
    """Return all texts of a language by key."""
    texts: dict[str, str] = {}
    for folder in _FOLDERS:
        for name in sorted(os.listdir(folder)):  # noqa: PTH208
            if name.endswith(f".{language}.json"):
                with open(os.path.join(folder, name), encoding="utf-8") as file:  # noqa: PTH118, PTH123
                    texts = json.load(file) | texts
    return texts


@cache
def catalogue_json(language: str, without: frozenset[str] = frozenset()) -> bytes:
    """Return ``catalogue`` as compact JSON in UTF-8, without the groups ``without``.

    A group is the first part of its keys, or all parts but the last.
    """
    texts = {
        key: text
        for key, text in catalogue(language).items()
        if key.partition(".")[0] not in without and key.rpartition(".")[0] not in without
    }
    return json.dumps(texts, ensure_ascii=False, separators=(",", ":")).encode()


class _Placeholders(dict[str, Any]):
    """Values of placeholders; one without a value stays as it is, so that a wrong text never hides an error."""

    def __missing__(self, key: str) -> str:
        return "{" + key + "}"


def text(key: str, language: str = "en", /, **params: Any) -> str:
    """Return the text of ``key``: English if the language does not have it, the key itself if no catalogue has it."""
    sentence = _sentence(key, language)
    if sentence is None:
        sentence = _sentence(key, "en")
    if sentence is None:
        return f"{key} {params}" if params else key
    values = _Placeholders({name: _localized(value, language) for name, value in params.items()})
    unspaced = _sentence("language.unspaced_letters", language)
    return (_close_gaps(sentence, values, re.compile(unspaced)) if unspaced else sentence).format_map(values)


def preferred_text(key: str, /, **params: Any) -> str:
    """Return the text of ``key`` in the language of this process, as for a line of its log."""
    return text(key, preferred(), **params)


def join(parts: Iterable[str], kind: ListParts, language: str) -> str:
    """Return the parts of a list as one text, with the mark of the language between them."""
    return text(f"language.between_{kind}", language).join(parts)


_PLACEHOLDER = re.compile(r"( ?)(\{(\w+)[^{}]*\})( ?)")


def _close_gaps(sentence: str, values: dict[str, Any], unspaced: re.Pattern[str]) -> str:
    """Return a sentence without the spaces that would stand between two unspaced letters once its values are in place.

    The catalogue of a language names these letters, for the page too; English has none.
    """

    def close(match: re.Match[str]) -> str:
        before, place, name, after = match.groups()
        value = str(values.get(name, ""))
        left, right = sentence[: match.start()][-1:], sentence[match.end() :][:1]
        if right == "{" and (following := _PLACEHOLDER.match(sentence, match.end())):
            right = str(values.get(following[3], ""))[:1]
        before = "" if unspaced.match(left) and unspaced.match(value[:1]) else before
        after = "" if unspaced.match(value[-1:]) and unspaced.match(right) else after
        return f"{before}{place}{after}"

    return _PLACEHOLDER.sub(close, sentence)


def _sentence(key: str, language: str) -> str | None:
    """Return None also if the catalogue can't be read: the report of another error must not fail."""
    try:
        return catalogue(language).get(key)
    except (OSError, ValueError):
        return None


def known(key: str) -> bool:
    """Return whether a catalogue has the key."""
    return _sentence(key, "en") is not None


def _localized(value: Any, language: str) -> Any:
    """Return a value in one language: a ``Text`` of a profile, the sentence of an error or an outcome, or a list.

    The mark between the items of a list is that of the language.
    """
    if isinstance(value, list | tuple):
        return join((str(_localized(item, language)) for item in value), "items", language)
    in_language = getattr(value, "in_language", None)
    if callable(in_language):
        return in_language(language)
    sentence = getattr(value, "text", None)
    return sentence(language) if callable(sentence) else value


def preferred() -> str:
    """Return the user's language, "zh" or "en": DRIVEBUS_LANG, else the locale."""
    names = (os.environ.get(name, "") for name in (LANGUAGE_VARIABLE, "LC_ALL", "LC_MESSAGES", "LANG"))
    chosen = next((name for name in names if name), "") or (locale.getlocale()[0] or "")
    return "zh" if chosen.lower().startswith(("zh", "chinese")) else "en"
