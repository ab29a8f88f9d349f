"""Questions on the terminal, answered in half-width or full-width characters: ``１``, ``ｙ`` and ``，`` too."""

from __future__ import annotations

import re

import click

from drivebus.cli import output
from drivebus.user_input import YES_WORDS, half_width

_CHINESE = re.compile("[一-鿿]")
_NO = frozenset({"", "n", "no", "否"})


def prompt(question: str, default: str | None = None, *, show_default: bool = True) -> str:
    """Return the answer to a question without surrounding blanks, in half-width characters.

    An answer with Chinese characters, such as the name of a file, stays as it is.
    """
    answer = prompt_text(question, default, show_default=show_default)
    return answer if _CHINESE.search(answer) else half_width(answer).strip()


def prompt_text(question: str, default: str | None = None, *, show_default: bool = True) -> str:
    """Return a text, such as a name, as it was typed."""
    answer: str = click.prompt(question, default=default, show_default=show_default, err=True)
    return answer.strip()


def confirm(question: str) -> bool:
    """Return whether the user answers yes; an empty answer is no. Any other answer is asked for again."""
    while True:
        answer = prompt(f"{question} [y/N]", "", show_default=False).lower()
        if answer in YES_WORDS | _NO:
            return answer in YES_WORDS
        output.print_note("cli.found_expected", found=answer, expected=output.text("cli.expect.yes_or_no"))
