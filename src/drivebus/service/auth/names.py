"""Names of users: the check of a new name, and the comparison of names that look alike."""

from __future__ import annotations

import re
import unicodedata
from functools import cache
from importlib.resources import files

from drivebus.control_characters import INVISIBLE_RANGES
from drivebus.service.auth.actor import SERVICE_NAME, STOP_ALL_NAME
from drivebus.service.auth.errors import InvalidInput

_USER_NAME = re.compile(r"[^\W_][\w.@-]{0,63}")
"""A name without the marks of its letters."""
MAX_NAME_LENGTH = 64  # characters, with marks
MAX_MARKS = 5  # of one letter, as in Burmese; more of them would cover other lines
_DIACRITICS = frozenset("\u0300\u0301\u0302\u0303\u0304\u0306\u0308\u0309\u030a\u030b\u030c\u0323\u0326\u0327\u0328")
"""Marks that each Latin, Greek or Cyrillic letter may have: none that its dot hides or that crosses it out."""
_WITH_DIACRITICS = frozenset({"LATIN", "GREEK", "CYRILLIC"})
_VOWELS_AM = (("\u0e4d\u0e32", "\u0e33"), ("\u0ecd\u0eb2", "\u0eb3"))
"""A vowel of Thai and of Lao that NFKC takes apart: with a tone mark its parts are drawn in another place."""
_SPLIT_AM = (
    (re.compile("\u0e4d([\u0e48-\u0e4b]+)\u0e32"), "\\1\u0e33"),
    (re.compile("\u0ecd([\u0ec8-\u0ecb]+)\u0eb2"), "\\1\u0eb3"),
)
"""The same vowel with its first part before the tone marks: it looks like the whole one after them."""
_INVISIBLE = re.compile(f"[{INVISIBLE_RANGES}]")
_EAST_ASIAN = frozenset(
    {"LATIN", "CJK", "HIRAGANA", "KATAKANA", "HANGUL", "BOPOMOFO", "IDEOGRAPHIC", "KATAKANA-HIRAGANA"}
)
"""Scripts that one name may mix: East Asian names with Latin letters. No letter of one looks like one of another."""


def normalized_name(name: str) -> str:
    """Return the common spelling of names that are meant to be the same (NFKC, case folded)."""
    folded = unicodedata.normalize("NFKC", name).casefold()
    for parts, letter in _VOWELS_AM:
        folded = folded.replace(parts, letter)
    return folded


def appearance(name: str) -> str:
    """Return a text that is the same for names that look the same although their letters are of other scripts."""
    marks_in_order = "".join(map(_sort_marks, _letters_with_marks(normalized_name(name).translate(_look_alikes()))))
    for pattern, letter in _SPLIT_AM:
        marks_in_order = pattern.sub(letter, marks_in_order)
    return normalized_name(marks_in_order)


def _letters_with_marks(name: str) -> list[str]:
    """Return the letters of a name, each with the marks after it."""
    letters: list[str] = []
    for character in name:
        if letters and _is_mark(character):
            letters[-1] += character
        else:
            letters.append(character)
    return letters


def _sort_marks(letter: str) -> str:
    """Return a letter with its marks in an order that does not depend on how they were written."""
    return letter[:1] + "".join(sorted(letter[1:], key=lambda mark: (unicodedata.combining(mark), mark)))


def _is_mark(character: str) -> bool:
    return unicodedata.category(character) in ("Mn", "Mc")


def _has_mark_twice(name: str) -> bool:
    """Return whether a letter has the same mark twice: both are drawn in one place."""
    letters = _letters_with_marks(unicodedata.normalize("NFD", name))
    return any(len(set(letter[1:])) < len(letter) - 1 for letter in letters)


@cache
def _look_alikes() -> dict[int, str]:
    """Return the text in place of each letter that looks like it; ``look_alikes.txt`` names source and licence."""
    lines = files("drivebus.service.auth").joinpath("look_alikes.txt").read_text(encoding="utf-8").splitlines()
    table: dict[int, str] = {}
    for line in lines:
        if not line.startswith("#"):
            text, _, others = line.partition(" ")
            table |= {ord(other): text if others else text[0] for other in others or text[1:]}
    while (resolved := {other: text.translate(table) for other, text in table.items()}) != table:
        table = resolved
    return table


def check_user_name(name: str) -> None:
    """Check that a user may have this name. Raises InvalidInput."""
    letters = _without_marks(name)
    is_visible = len(name) <= MAX_NAME_LENGTH and not _INVISIBLE.search(name) and not _has_mark_twice(name)
    if not (is_visible and _USER_NAME.fullmatch(letters) and name == normalized_name(name)):
        raise InvalidInput("auth.bad_name", name=name)
    scripts = {_script(letter) for letter in letters if letter.isalpha()}
    if len(scripts) > 1 and not scripts <= _EAST_ASIAN:
        raise InvalidInput("auth.mixed_scripts", name=name)
    if appearance(name) in (appearance(SERVICE_NAME), appearance(STOP_ALL_NAME)):
        raise InvalidInput("auth.reserved_name", name=name)


def _without_marks(name: str) -> str:
    """Return the name without the marks that its letters may have, at most ``MAX_MARKS`` each; all others stay."""
    letters: list[str] = []
    marks = 0
    for character in name:
        marks += 1
        if not (letters and marks <= MAX_MARKS and _is_mark_of(character, letters[-1])):
            letters.append(character)
            marks = 0
    return "".join(letters)


def _is_mark_of(character: str, letter: str) -> bool:
    """Return whether a character is a mark that this letter may have: of its own script, or a known diacritic."""
    if not (_is_mark(character) and letter.isalpha()):
        return False
    return _script(character) == _script(letter) or (character in _DIACRITICS and _script(letter) in _WITH_DIACRITICS)


def _script(letter: str) -> str:
    """Return the script of a letter or mark: the first word of its name in Unicode."""
    return unicodedata.name(letter, "?").partition(" ")[0]
