"""The terminal of a command is no port of it."""

from __future__ import annotations

import sys

import pytest

from fixtures.child_process import PtyTerminal

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="ptys of POSIX")


@pytest.mark.parametrize(
    ("command", "code"),
    [
        (("status", "/dev/stdin", "--model", "vc660", "--address", "1"), 1),
        (("stop", "/dev/stdin", "--model", "vc660", "--address", "1"), 4),
        (("scan", "/dev/stdin", "--models", "vc660", "--addresses", "1", "--listen-seconds", "0"), 1),
    ],
    ids=lambda words: words[0] if isinstance(words, tuple) else "",
)
def test_the_own_terminal_is_not_opened_as_a_port(command: tuple[str, ...], code: int) -> None:
    """The link of ended simulated drives led to it: a request was printed there, and keys were taken for replies."""
    with PtyTerminal(*command, "--lang", "en") as terminal:
        terminal.wait_for("the terminal of this command")
        assert terminal.exit_code() == code
        assert "\x01\x08" not in terminal.output, "no frame was printed"
