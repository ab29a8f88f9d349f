"""Control and invisible characters of a text: found, replaced, or all that it consists of."""

from __future__ import annotations

import re

CONTROL_RANGES = r"\x00-\x1f\x7f-\x9f\u061c\u200b\u200e\u200f\u2028-\u202e\u2060\u2066-\u2069\ufeff"
"""Control characters, line separators, invisible spaces and bidirectional marks, as the inside of a character class.

By these a text could move the cursor, clear the screen or set the title of a terminal, forge a line, or show its
characters in another order.
"""
CONTROL_CHARACTERS = re.compile(f"[{CONTROL_RANGES}]")
INVISIBLE_RANGES = (
    r"\xad\u034f\u115f\u1160\u17b4\u17b5\u180b-\u180f\u200c\u200d\u2061-\u2065\u206a-\u206f"
    r"\u2800\u3164\ufe00-\ufe0f\uffa0\ufff0-\ufff8"
)
"""Characters that have no shape of their own, but a use within a text (Unicode: Default_Ignorable_Code_Point), and the
blank braille pattern.
"""
_VISIBLE = re.compile(rf"[^\s{CONTROL_RANGES}{INVISIBLE_RANGES}\U000e0000-\U000e0fff]")


def without_control_characters(text: str, *, keep: str = "") -> str:
    """Replace the control characters of a text that comes from elsewhere by ``�``, except those to ``keep``."""
    return CONTROL_CHARACTERS.sub(lambda found: found[0] if found[0] in keep else "�", text)


def is_blank(text: str) -> bool:
    """Return whether a text shows nothing: spaces, control and invisible characters only, or none at all."""
    return _VISIBLE.search(text) is None
