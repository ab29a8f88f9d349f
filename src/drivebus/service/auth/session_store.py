"""Sessions outlive the web process: a crash of it must not put a password between anybody and a stop.

Only hashes are kept. Times are of the monotonic clock, so they count only until the machine starts anew.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from drivebus.service.auth.user_file import replace_private

_BOOT = Path("/proc/sys/kernel/random/boot_id")


@dataclass(slots=True)
class SessionRecord:
    """Whose session it is, whichever process holds it. Times are monotonic seconds (S20)."""

    id: str
    """Opaque, no secret: leases belong to it, the audit trail names it."""
    csrf: str
    user: str
    stamp: str
    """Of the user as it was at the login."""
    address: str
    opened: float
    active: float

    def fields(self) -> dict[str, Any]:
        """Those of every session."""
        return {one.name: getattr(self, one.name) for one in fields(SessionRecord)}


@dataclass(slots=True, kw_only=True)
class StoredSession(SessionRecord):
    """One session as it is kept."""

    digest: str
    """Of its secret."""


@dataclass(frozen=True, slots=True)
class _SessionFile:
    boot: str
    sessions: tuple[StoredSession, ...]


_SESSION_FILE_ADAPTER = TypeAdapter(_SessionFile)


class SessionStore:
    """``sessions.json`` in the state directory (0600)."""

    def __init__(self, directory: Path) -> None:
        self.path = directory / "sessions.json"

    def read(self) -> tuple[StoredSession, ...]:
        """What was kept since the machine started; nothing where the file can't be read: everybody logs in again."""
        with contextlib.suppress(OSError, ValidationError):
            found = _SESSION_FILE_ADAPTER.validate_json(self.path.read_bytes())
            return found.sessions if found.boot == _boot_id() != "" else ()
        return ()

    def write(self, sessions: tuple[StoredSession, ...]) -> None:
        """Nothing happens where it can't be written: logging in and out go on."""
        with contextlib.suppress(OSError):
            replace_private(self.path, _SESSION_FILE_ADAPTER.dump_json(_SessionFile(_boot_id(), sessions)))


def _boot_id() -> str:
    """Empty where the system does not tell: then nothing is believed."""
    with contextlib.suppress(OSError):
        return _BOOT.read_text().strip()
    return ""
