"""Where the trail lies: the file that is written, the full ones before it, its lines from either end."""

from __future__ import annotations

import errno
import os
import re
import secrets
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from drivebus.service.storage.append_log import write_durably

AUDIT_FILE: Final = "audit.jsonl"
ROTATED_FILE: Final = re.compile(r"audit-(\d{12})\.jsonl")
"""A file that is full is called after the number of its first record."""
READ_BLOCK_BYTES: Final = 1 << 16
MIN_KEY_BYTES: Final = 32
"""Octets."""


@dataclass(frozen=True, slots=True)
class AuditPaths:
    """The files of one plant's trail."""

    folder: Path
    checkpoints: Path
    """The second file: on another disk or machine it shows more."""
    key: Path
    """What the checkpoints are made under; outside ``folder``, so that a copy of that does not hold it."""

    @classmethod
    def of(cls, folder: Path, checkpoints: Path | None = None, key: Path | None = None) -> AuditPaths:
        return cls(
            folder,
            checkpoints or folder / "checkpoints.jsonl",
            key or folder.parent / f"{folder.name}.audit.key",
        )

    @property
    def current(self) -> Path:
        return self.folder / AUDIT_FILE

    def rotated(self, first: int) -> Path:
        return self.folder / f"audit-{first:012}.jsonl"

    def files(self) -> list[Path]:
        """All there are, oldest first. Raises OSError."""
        there = [*self.folder.iterdir()] if self.folder.exists() else []
        full = sorted(path for path in there if ROTATED_FILE.fullmatch(path.name))
        return [*full, self.current] if self.current in there else full

    def create_key(self) -> bytes:
        """The key; made where there is none. Raises OSError."""
        if not self.key.exists():
            write_durably(self.key, secrets.token_hex(32).encode() + b"\n")
        return self.read_key()

    def read_key(self) -> bytes:
        """Raises OSError, also where it is too short to be one."""
        key = self.key.read_bytes().strip()
        if len(key) < MIN_KEY_BYTES:
            raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))
        return key


def first_number_of(path: Path) -> int | None:
    """The number of the first record of a full file; None for the file that is written."""
    found = ROTATED_FILE.fullmatch(path.name)
    return int(found[1]) if found else None


def lines_backwards(path: Path) -> Iterator[bytes]:
    """Whole lines without their ends, the last one first, without an unfinished one. Raises OSError."""
    with path.open("rb") as file:
        at = file.seek(0, os.SEEK_END)
        rest, ended = b"", False
        while at > 0:
            size = min(READ_BLOCK_BYTES, at)
            at -= size
            file.seek(at)
            first, *lines = (file.read(size) + rest).split(b"\n")
            rest = first
            if lines and not ended:
                lines.pop()
                ended = True
            yield from reversed(lines)
        if ended:
            yield rest
