"""Sockets of the service: their names, paths of any length, and the form of a reply."""

from __future__ import annotations

import contextlib
import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path

from drivebus.errors import ConfigurationError

MAX_SOCKET_PATH_BYTES = 100
MAX_MESSAGE_BYTES = 4 * 1024 * 1024
"""Bytes of one message."""
SERVICE_SOCKET, STOP_SOCKET = "plant.sock", "stop.sock"
STOP_REQUEST, STOP_RECEIVED = b"stop all\n", b"received\n"
"""Only request of ``stop.sock``, and its immediate answer, which shows that the service does not hang."""


@contextlib.contextmanager
def short_socket_path(path: Path) -> Iterator[str]:
    """Yield the path, or a shorter one to the same place that works in this block: the system takes 107 bytes.

    Raises ConfigurationError.
    """
    text = str(path)
    if len(os.fsencode(text)) <= MAX_SOCKET_PATH_BYTES:
        yield text
        return
    if not sys.platform.startswith("linux"):
        raise ConfigurationError("plant.socket_path", path=text, longest=MAX_SOCKET_PATH_BYTES)
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        yield f"/proc/self/fd/{folder}/{path.name}"
    finally:
        os.close(folder)


REPLY_HEAD = re.compile(rb'\{"id": ?(\d+), ?"(result|error|live)": ?')
"""Start of every line that the service sends: the request's number and the kind of reply; its JSON and ``}`` follow."""


def split_reply(line: bytes) -> tuple[int, str, bytes]:
    """Return number, kind and JSON text of a line of the service, without parsing it. Raises ValueError."""
    head = REPLY_HEAD.match(line)
    if head is None:
        raise ValueError(line[:60])
    return int(head[1]), head[2].decode(), line.rstrip()[head.end() : -1]
