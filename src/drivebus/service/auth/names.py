"""Names of users: the check of a new name, and the comparison of names that look alike."""

from __future__ import annotations

import re
import unicodedata
from functools import cache
from importlib.resources import files

from drivebus.service.auth.actor import SERVICE_NAME
from drivebus.service.auth.errors import InvalidInput

_USER_NAME = re.compile(r"[^\W_][\w.@-]{0,63}")
_EAST_ASIAN = frozenset(
    {"LATIN", "CJK", "HIRAGANA", "KATAKANA", "HANGUL", "BOPOMOFO", "IDEOGRAPHIC", "KATAKANA-HIRAGANA"}
)
"""Scripts that one name may mix: East Asian names with Latin letters. No letter of one looks like one of another."""


def normalized_name(name: str) -> str:
    """Return the common spelling of names that are meant to be the same (NFKC, case folded)."""
    return unicodedata.normalize("NFKC", name).casefold()


def appearance(name: str) -> str:
    """Return a text that is the same for names that look the same although their letters are of other scripts."""
    return normalized_name(name).translate(_look_alikes())


@cache
def _look_alikes() -> dict[int, str]:
    """Return the letter in place of each that looks like it; ``look_alikes.txt`` names source and licence."""
    lines = files("drivebus.service.auth").joinpath("look_alikes.txt").read_text(encoding="utf-8").splitlines()
    alike = {other: line[0] for line in lines if not line.startswith("#") for other in line[1:]}
    for other in alike:
        while alike[other] in alike:
            alike[other] = alike[alike[other]]
    return {ord(other): letter for other, letter in alike.items()}


def check_user_name(name: str) -> None:
    """Check that a user may have this name. Raises InvalidInput."""
    if not _USER_NAME.fullmatch(name) or name != normalized_name(name):
        raise InvalidInput("auth.bad_name", name=name)
    scripts = {_script(letter) for letter in name if letter.isalpha()}
    if len(scripts) > 1 and not scripts <= _EAST_ASIAN:
        raise InvalidInput("auth.mixed_scripts", name=name)
    if appearance(name) == SERVICE_NAME:
        raise InvalidInput("auth.reserved_name", name=name)


def _script(letter: str) -> str:
    """Return the script of a letter: the first word of its name in Unicode."""
    return unicodedata.name(letter, "?").partition(" ")[0]
