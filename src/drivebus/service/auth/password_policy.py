"""Policy for new passwords: length, and neither guessable nor frequent. Pure, but for the list that it reads."""

from __future__ import annotations

import re
import unicodedata
from functools import cache
from importlib.resources import files

from drivebus.service.auth.errors import InvalidInput

MIN_PASSWORD_LENGTH = 10
MAX_PASSWORD_LENGTH = 200
_MIN_DIFFERENT_CHARACTERS = 5
MIN_UNCOMMON_CHARACTERS = 4
"""Different characters that a password needs besides common words, keyboard rows and digits."""
_MIN_NAME_LENGTH = 3
"""ASCII characters of the shortest user name that no password may contain: two are in many passwords by chance."""
_COMMON_WORDS = """
password passwort passwd pass login secret default changeme letmein welcome hello iloveyou woaini wodemima mima
admin administrator root user guest test master super operator engineer viewer service company office factory
drive drivebus inverter motor pump plant dragon monkey football sunshine princess summer winter spring autumn
"""
_KEYBOARD_ROWS = (
    "abcdefghijklmnopqrstuvwxyz",
    "01234567890",
    "qwertyuiop",
    "asdfghjkl",
    "zxcvbnm",
    "1q2w3e4r5t6y7u8i9o0p",
    "1qaz2wsx3edc4rfv5tgb6yhn7ujm",
    "!@#$%^&*()",
)
MIN_KNOWN_LENGTH = 4
"""Length of the shortest entry of ``common_passwords``."""
_KEYBOARD_RUN_LENGTH = 3
"""Neighbours of a keyboard row, in either direction, that count as common."""
_LEET_SPELLING = str.maketrans("@4$5031!", "aassoeii")
"""Substitutions such as p@ssw0rd for password."""
_ADDED_CHARACTERS = "0123456789-_.,+*#?/ "
"""Digits and signs that stand before or behind a word; not @, $ and !, which may be letters of it."""


def _keyboard_runs(row: str) -> set[str]:
    return {
        direction[at : at + _KEYBOARD_RUN_LENGTH]
        for direction in (row, row[::-1])
        for at in range(len(row) - _KEYBOARD_RUN_LENGTH + 1)
    }


_COMMON_PARTS = frozenset(_COMMON_WORDS.split()).union(*map(_keyboard_runs, _KEYBOARD_ROWS))


def is_guessable(password: str) -> bool:
    """Return whether a password is made of common words, keyboard rows and digits, and few other characters."""
    folded = password.casefold()
    return any(_is_common(each) for each in (folded, folded.translate(_LEET_SPELLING)))


@cache
def common_passwords() -> frozenset[str]:
    """Return frequent passwords, names and words; ``common_passwords.txt`` names source and licence."""
    lines = files("drivebus.service.auth").joinpath("common_passwords.txt").read_text(encoding="ascii").splitlines()
    return frozenset(line for line in lines if not line.startswith("#"))


def is_frequent(password: str) -> bool:
    """Return whether a password is a frequent one, repeated or not, or two of them, with digits and signs added.

    Three common words and more are a passphrase, which is hard to guess.
    """
    folded = password.casefold()
    # Without what was added first: "2026" is no spelling of letters.
    spellings = {folded, *(each.translate(_LEET_SPELLING) for each in (folded, folded.strip(_ADDED_CHARACTERS)))}
    texts = {"".join(filter(keep, spelling)) for spelling in spellings for keep in (str.isalnum, str.isalpha)}
    return any(_is_frequent_text(text) for text in (*spellings, *texts))


def _is_frequent_text(text: str) -> bool:
    known, length = common_passwords(), len(text)
    units = {text[:size] for size in range(MIN_KNOWN_LENGTH, length + 1) if text == text[:size] * (length // size)}
    halves = ((text[:at], text[at:]) for at in range(MIN_KNOWN_LENGTH, length - MIN_KNOWN_LENGTH + 1))
    return not known.isdisjoint(units) or any(first in known and second in known for first, second in halves)


def _is_common(text: str) -> bool:
    matches = ((match.start(), part) for part in _COMMON_PARTS for match in re.finditer(f"(?={re.escape(part)})", text))
    common = {at for start, part in matches for at in range(start, start + len(part))}
    uncommon = {character for at, character in enumerate(text) if at not in common and not character.isdigit()}
    return (bool(common) or text.isdigit()) and len(uncommon) < MIN_UNCOMMON_CHARACTERS


def check_password_policy(password: str, name: str) -> str:
    """Return ``password`` if the user ``name`` may have it. Raises InvalidInput with the reason."""
    text = normalized_password(password)
    if not MIN_PASSWORD_LENGTH <= len(text) <= MAX_PASSWORD_LENGTH:
        raise InvalidInput("auth.password_length", shortest=MIN_PASSWORD_LENGTH, longest=MAX_PASSWORD_LENGTH)
    guessable = is_guessable(text) or is_frequent(text) or _contains_name(text, name)
    if guessable or len(set(text)) < _MIN_DIFFERENT_CHARACTERS:
        raise InvalidInput("auth.password_common", different=_MIN_DIFFERENT_CHARACTERS, own=MIN_UNCOMMON_CHARACTERS)
    return password


def _contains_name(password: str, name: str) -> bool:
    """Return whether a password contains the user name; a short name may be part of it, with enough other letters."""
    folded = name.casefold()
    rest = password.casefold().replace(folded, "")
    is_long = len(name) >= _MIN_NAME_LENGTH or not name.isascii()  # two Chinese characters are a whole name
    is_little_else = len(set(filter(str.isalpha, rest))) < MIN_UNCOMMON_CHARACTERS
    return folded in password.casefold() and (is_long or is_little_else)


def normalized_password(password: str) -> str:
    """Return a password in one form (NFC), however the keyboard composes its letters."""
    return unicodedata.normalize("NFC", password)
