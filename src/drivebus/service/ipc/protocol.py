"""Sockets of the service: their names, places and paths of any length, and the form of a reply."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import re
import stat
import sys
from collections.abc import Iterator
from pathlib import Path

from drivebus.atomic_write import PRIVATE_FOLDER_MODE
from drivebus.errors import ConfigurationError, Expired

MAX_SOCKET_PATH_BYTES = 100
MAX_MESSAGE_BYTES = 4 * 1024 * 1024
"""Bytes of one message."""
MAX_MOTION_WAIT_S = 2.0
"""A command that moves a motor is not done where it waited longer for a process that was suspended or overloaded.

Shorter than a client waits, so that no motor starts after its user was answered that the service hangs.
"""
SERVICE_SOCKET, STOP_SOCKET = "plant.sock", "stop.sock"
RUNTIME_FOLDERS = ("/run/user/{uid}", "/run/drivebus", "/tmp")
"""Places of the sockets of a service that cannot write its state directory. The systemd unit creates the second one."""
STOP_REQUEST, STOP_RECEIVED = b"stop all\n", b"received\n"
"""Only request of ``stop.sock``, and its immediate answer, which shows that the service does not hang."""


def late_motion_error(waited_s: float) -> Expired:
    """Return the error of a command that waited longer than ``MAX_MOTION_WAIT_S``: nothing was sent."""
    error = Expired("plant.waited_too_long", waited_s=round(waited_s, 1), limit_s=MAX_MOTION_WAIT_S)
    error.may_be_running = False
    return error


def socket_path(directory: Path, name: str) -> Path:
    """Return the path of a socket of the service with this state directory.

    A socket in a runtime folder takes precedence: the service removes it when it listens in the state directory again.
    """
    with contextlib.suppress(OSError):
        uid = directory.stat().st_uid
        for folder in _runtime_folders(directory, uid):
            if _is_private(folder, uid) and (folder / name).is_socket():
                return folder / name
    return directory / name


def create_runtime_folder(directory: Path) -> Path:
    """Create a folder of this user for the sockets of a state directory that cannot be written. Raises OSError."""
    uid, failure = os.geteuid(), OSError(errno.ENOENT, os.strerror(errno.ENOENT))
    for folder in _runtime_folders(directory, uid):
        try:
            folder.mkdir(mode=PRIVATE_FOLDER_MODE, exist_ok=True)
        except OSError as error:
            failure = error
        else:
            if _is_private(folder, uid):
                return folder
            failure = OSError(errno.EACCES, os.strerror(errno.EACCES))
    raise failure


def remove_runtime_folders(directory: Path) -> None:
    """Remove the sockets that a service left in runtime folders. Never raises."""
    uid = os.geteuid()
    for folder in _runtime_folders(directory, uid):
        if _is_private(folder, uid):
            with contextlib.suppress(OSError):
                for name in (SERVICE_SOCKET, STOP_SOCKET):
                    (folder / name).unlink(missing_ok=True)
                folder.rmdir()


def _runtime_folders(directory: Path, uid: int) -> Iterator[Path]:
    digest = hashlib.sha256(os.fsencode(directory.resolve())).hexdigest()[:16]
    for base in RUNTIME_FOLDERS:
        yield Path(base.format(uid=uid)) / f"drivebus-{uid}-{digest}"


def _is_private(folder: Path, uid: int) -> bool:
    """Return whether a folder is one that only this user can change: any user may create names below /tmp."""
    try:
        status = folder.lstat()
    except OSError:
        return False
    return stat.S_ISDIR(status.st_mode) and status.st_uid == uid and not status.st_mode & (stat.S_IRWXG | stat.S_IRWXO)


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
