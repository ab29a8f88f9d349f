"""One look-up for every sentence that a user sees.

Catalogues are JSON files beside this module, ``<room>.<language>.json``, each an object of key → sentence with
``{name}`` places. A key is ``room.name``; rooms never share keys, languages always have the same keys (a test).
"""

from __future__ import annotations

import json
import locale
import os
from functools import cache
from typing import Any

LANGUAGES = ("en", "zh")


_FOLDERS = [os.path.dirname(__file__)]  # noqa: PTH120  importlib.resources alone costs a third of a bare click start


def add_folder(folder: str | os.PathLike[str]) -> None:
    """Add the catalogues of another package; its keys never replace existing ones."""
    path = os.fspath(folder)
    if path not in _FOLDERS:
        _FOLDERS.append(path)
        catalogue.cache_clear()


@cache
def catalogue(language: str) -> dict[str, str]:
    """All sentences of a language, by key."""
    found: dict[str, str] = {}
    for folder in _FOLDERS:
        for name in sorted(os.listdir(folder)):  # noqa: PTH208
            if name.endswith(f".{language}.json"):
                with open(os.path.join(folder, name), encoding="utf-8") as file:  # noqa: PTH118, PTH123
                    found = json.load(file) | found
    return found


class _Places(dict[str, Any]):
    """Leaves a place without a value standing, so that a wrong sentence never hides an error."""

    def __missing__(self, key: str) -> str:
        return "{" + key + "}"


def text(key: str, language: str = "en", /, **params: Any) -> str:
    """The sentence for ``key``; English where the language lacks it, the key itself where nobody knows it."""
    sentence = _sentence(key, language) or _sentence(key, "en")
    if sentence is None:
        return f"{key} {params}" if params else key
    return sentence.format_map(_Places({name: _shown(value, language) for name, value in params.items()}))


def _sentence(key: str, language: str) -> str | None:
    """None also where the catalogue can't be read just now: whoever tells of an error must not fail at it."""
    try:
        return catalogue(language).get(key)
    except (OSError, ValueError):
        return None


def known(key: str) -> bool:
    """Is there such a sentence?"""
    return _sentence(key, "en") is not None


def _shown(value: Any, language: str) -> Any:
    """Texts in both languages (``Text`` of a profile) show their own side, errors and outcomes say their sentence."""
    if hasattr(value, "en") and hasattr(value, "zh"):
        return getattr(value, language)
    sentence = getattr(value, "text", None)
    return sentence(language) if callable(sentence) else value


def preferred() -> str:
    """The user's language: DRIVEBUS_LANG, else the locale; "zh" or "en"."""
    names = (os.environ.get(name, "") for name in ("DRIVEBUS_LANG", "LC_ALL", "LC_MESSAGES", "LANG"))
    chosen = next((name for name in names if name), "") or (locale.getlocale()[0] or "")
    return "zh" if chosen.lower().startswith(("zh", "chinese")) else "en"
