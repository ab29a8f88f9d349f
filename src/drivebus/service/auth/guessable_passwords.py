"""Passwords that somebody who knows no secret tries first: common words, rows of a keyboard, digits. Pure."""

from __future__ import annotations

import re

MIN_UNCOMMON_CHARACTERS = 4
"""So many different characters must be left besides what is common."""
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
)
_KEYBOARD_RUN_LENGTH = 3
"""So many neighbours of a row, either way, are one."""
_LEET_SPELLING = str.maketrans("@4$5031!", "aassoeii")
"""p@ssw0rd is password."""


def _keyboard_runs(row: str) -> set[str]:
    return {
        way[at : at + _KEYBOARD_RUN_LENGTH]
        for way in (row, row[::-1])
        for at in range(len(row) - _KEYBOARD_RUN_LENGTH + 1)
    }


_COMMON_PARTS = frozenset(_COMMON_WORDS.split()).union(*map(_keyboard_runs, _KEYBOARD_ROWS))


def is_guessable(password: str) -> bool:
    """Is it nothing but common words, rows and digits, p@ssw0rd too, and a few characters more?"""
    folded = password.casefold()
    return any(_is_common(each) for each in (folded, folded.translate(_LEET_SPELLING)))


def _is_common(said: str) -> bool:
    found = ((match.start(), part) for part in _COMMON_PARTS for match in re.finditer(f"(?={re.escape(part)})", said))
    known = {at for start, part in found for at in range(start, start + len(part))}
    own = {character for at, character in enumerate(said) if at not in known and not character.isdigit()}
    return (bool(known) or said.isdigit()) and len(own) < MIN_UNCOMMON_CHARACTERS
