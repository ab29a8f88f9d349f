"""Terminal and standard streams of this process: whether they are closed, and the output after that."""

from __future__ import annotations

import codecs
import errno
import os
import stat
import sys
from contextlib import suppress
from typing import TextIO

_PLAIN_CHARACTERS = {"·": "-", "–": "-", "…": "...", "→": "->", "≤": "<=", "“": '"', "”": '"', "°": "deg"}
"""ASCII characters that stand for those of the English texts."""


def encode_plainly(error: UnicodeError) -> tuple[str, int]:
    """Return what stands for a character that the encoding of a stream lacks: ASCII characters, else its escape."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    character = error.object[error.start]
    plain = _PLAIN_CHARACTERS.get(character) or character.encode("ascii", "backslashreplace").decode("ascii")
    return plain, error.start + 1


PLAIN_ENCODING = "drivebus.plain"  # name of ``encode_plainly`` as the error handler of a stream
codecs.register_error(PLAIN_ENCODING, encode_plainly)


def open_missing_streams() -> None:
    """Open the null device in the place of each standard stream that was closed when the process began.

    Otherwise the first file or port that is opened would get its number, and Python's stream would be None.
    What is written to standard output fails, as on a full disk: a result that is lost is no success.
    """
    streams = (("stdin", "r", os.O_RDWR), ("stdout", "w", os.O_RDONLY), ("stderr", "w", os.O_RDWR))
    for number, (name, mode, access) in enumerate(streams):
        try:
            os.fstat(number)
        except OSError:
            null_device = os.open(os.devnull, access)  # with the lowest free number, which is this one
            os.set_inheritable(null_device, True)
            setattr(sys, name, os.fdopen(null_device, mode, encoding="utf-8"))


def terminal_is_closed() -> bool:
    """Return whether the terminal was closed, so that no Ctrl-C can come."""
    try:
        os.tcgetpgrp(0)
    except OSError as error:
        return error.errno == errno.EIO  # another error: there never was one, as in a systemd unit
    return False


def discard_terminal_output() -> None:
    """Discard all further output to a terminal, which was closed; files and pipes still get theirs."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            if stat.S_ISCHR(os.fstat(stream.fileno()).st_mode):
                discard_output(stream)


def print_line(text: str, stream: TextIO) -> None:
    """Print a line at once; a stream that can't be written gets no further output."""
    try:
        print(text, file=stream, flush=True)
    except OSError:
        discard_output(stream)


def discard_output(stream: TextIO) -> None:
    """Discard all further output to a stream, which would fail: at the end of the process too, with exit code 120."""
    with suppress(OSError, ValueError):  # a stream of a test has no descriptor
        null_device = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null_device, stream.fileno())
        os.close(null_device)
