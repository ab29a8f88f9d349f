"""Files of the audit trail: the chain of records, its checkpoints, rotation, and recovery after a killed writer.

Every function blocks for as long as the disk takes.
"""

from __future__ import annotations

import errno
import os
import re
import secrets
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Final

from drivebus.atomic_write import atomic_write_private, fsync_directory
from drivebus.regular_file import read_regular_file
from drivebus.service.audit import records
from drivebus.service.audit.records import AuditCheckpoint, AuditEntry
from drivebus.service.storage import append_log
from drivebus.service.storage.append_log import AppendLog
from drivebus.types import Json

AUDIT_FILE: Final = "audit.jsonl"
ROTATED_FILE: Final = re.compile(r"audit-(\d{12})\.jsonl")
"""A full file is named after the number of its first record."""
READ_BLOCK_BYTES: Final = 1 << 16
MIN_KEY_BYTES: Final = 32
RECORDS_MISSING: Final = "audit.cut"
"""``what`` of the entry that reports records or checkpoints missing at the start."""
KEY_REPLACED: Final = "audit.key_replaced"
"""``what`` of the entry that reports checkpoints that were not made with the key of the start."""
HEAD_MISSING: Final = "audit.head_missing"
"""``what`` of the entry that reports checkpoints without a head at the start."""
MAX_AUDIT_FILE_BYTES: Final = 16 * 1024 * 1024
"""A larger file is renamed after its first record, and the chain continues in a new one."""


@dataclass(frozen=True, slots=True)
class AuditPaths:
    """Paths of the audit trail of one plant."""

    folder: Path
    checkpoints: Path
    """Checkpoint file. On another disk or machine it detects more."""
    key: Path
    """Key of the checkpoints' MAC. Outside ``folder``, so that a copy of the folder does not contain it."""
    head: Path
    """Newest checkpoint. Outside ``folder``, so that removed records and checkpoints are detected together."""

    @classmethod
    def of(
        cls, folder: Path, checkpoints: Path | None = None, key: Path | None = None, head: Path | None = None
    ) -> AuditPaths:
        return cls(
            folder,
            checkpoints or folder / "checkpoints.jsonl",
            key or folder.parent / f"{folder.name}.audit.key",
            head or folder.parent / f"{folder.name}.audit.head",
        )

    @property
    def current(self) -> Path:
        return self.folder / AUDIT_FILE

    def rotated(self, first: int) -> Path:
        return self.folder / f"audit-{first:012}.jsonl"

    def files(self) -> list[Path]:
        """Return all existing files, oldest first. Raises OSError."""
        there = [*self.folder.iterdir()] if self.folder.exists() else []
        full = sorted(path for path in there if ROTATED_FILE.fullmatch(path.name))
        return [*full, self.current] if self.current in there else full

    def create_key(self) -> bytes:
        """Return the key; create it where there is none. Raises OSError."""
        if not self.key.exists():
            atomic_write_private(self.key, secrets.token_hex(32).encode() + b"\n")
        return self.read_key()

    def read_key(self) -> bytes:
        """Return the key. Raises OSError, also for a key that is too short."""
        key = read_regular_file(self.key).strip()
        if len(key) < MIN_KEY_BYTES:
            raise OSError(errno.EINVAL, os.strerror(errno.EINVAL), str(self.key))
        return key


def first_number_of(path: Path) -> int | None:
    """Return the number of the first record of a full file; None for the current file."""
    match = ROTATED_FILE.fullmatch(path.name)
    return int(match[1]) if match else None


def lines_backwards(path: Path) -> Iterator[bytes]:
    """Yield complete lines without their ends, last line first. Raises OSError."""
    with append_log.open_to_read(path) as file:
        at = file.seek(0, os.SEEK_END)
        rest, ended = b"", False
        while at > 0:
            size = min(READ_BLOCK_BYTES, at)
            at -= size
            file.seek(at)
            rest, *lines = (file.read(size) + rest).split(b"\n")
            if lines and not ended:
                lines.pop()
                ended = True
            yield from reversed(lines)
        if ended:
            yield rest


@dataclass(frozen=True, slots=True)
class TornTail:
    """End of a file that an interrupted write left: ``torn`` holds the bytes after ``valid_bytes``."""

    path: Path
    valid_bytes: int
    torn: bytes


def unterminated_tail(path: Path) -> TornTail:
    """Return the bytes after the last line end. Raises OSError."""
    size, data = path.stat().st_size, append_log.read_tail(path)
    return _tail_from(path, size, data, data.rfind(b"\n") + 1)


def torn_tail(path: Path, safe: int) -> TornTail:
    """Return the bytes from the first broken record at the end of a file on. Raises OSError.

    Records up to ``safe`` never belong to it: a checkpoint proves that they were complete, so that a broken one among
    them was edited and must stay for ``verify``.
    """
    size, data = path.stat().st_size, append_log.read_tail(path)
    cut = end = data.rfind(b"\n") + 1
    while end > 0:
        start = data.rfind(b"\n", 0, end - 1) + 1
        if start == 0 and len(data) < size:  # the block begins in the middle of a line
            break
        record = records.decode_record(data[start : end - 1])
        if record is None:
            cut = start
        elif record.n <= safe:
            break
        end = start
    return _tail_from(path, size, data, cut)


def _tail_from(path: Path, size: int, data: bytes, at: int) -> TornTail:
    return TornTail(path, size - len(data) + at, data[at:])


class AuditChain:
    """Writer of the trail of one plant. It must be the only one: the service holds the lock of the state directory."""

    def __init__(
        self, paths: AuditPaths, now_ms: Callable[[], int], max_file_bytes: int = MAX_AUDIT_FILE_BYTES
    ) -> None:
        self.paths, self._now_ms, self._max_file_bytes = paths, now_ms, max_file_bytes
        self._records, self._checkpoints = AppendLog(paths.current), AppendLog(paths.checkpoints)
        self._is_open = False
        self._recovery_entries: list[AuditEntry] = []
        self._key = b""
        self._last_number, self._last_hash = 0, records.GENESIS_HASH
        self._first_number = 1
        """Number of the first record of the current file."""
        self._changed = False
        """Whether a record was written since the last checkpoint."""
        self._checkpoint_number, self._checkpoint_mac = 0, records.GENESIS_HASH
        self._checkpoint_record = 0
        """Number of the record that the last checkpoint covers."""
        self._unwritten_head = b""
        """Line of the newest checkpoint while the head is older."""

    def open(self) -> list[AuditEntry]:
        """Recover the files and open them, once. Return entries that report what was found. Raises OSError."""
        if self._is_open:
            return []
        self._recovery_entries.clear()  # of an earlier opening that failed
        self._key = self.paths.create_key()
        checkpoint = self._load_last_checkpoint()
        files = self.paths.files()
        if files:
            self._quarantine_torn(torn_tail(files[-1], self._checkpoint_record))
        self._continue_after(files)
        self._records.open()
        if self._last_number < self._checkpoint_record or checkpoint < self._checkpoint_number:
            self._recovery_entries.append(
                AuditEntry(
                    what=RECORDS_MISSING, params={"last": self._last_number, "checkpoint": self._checkpoint_record}
                )
            )
        self._is_open = True
        entries, self._recovery_entries = self._recovery_entries, []
        return entries

    def _load_last_checkpoint(self) -> int:
        """Continue after the last checkpoint, or after a newer head, so that ``verify`` reports the gap for good.

        Return the number of the last checkpoint in its file; 0: there is none.
        """
        line, head_line = self._last_checkpoint_line(), self._head_line()
        last = records.decode_checkpoint(line, None)
        head = records.decode_checkpoint(head_line, self._key)
        if (last and not records.decode_checkpoint(line, self._key)) or (head_line and not head):
            self._recovery_entries.append(AuditEntry(what=KEY_REPLACED))
        if last and not head_line:
            self._recovery_entries.append(AuditEntry(what=HEAD_MISSING))
        newest = max((record for record in (last, head) if record), key=lambda record: record.number, default=None)
        if newest is not None:
            self._checkpoint_number, self._checkpoint_mac = newest.number, newest.mac
            self._checkpoint_record = newest.n
        return last.number if last else 0

    def _last_checkpoint_line(self) -> bytes:
        """Return the last checkpoint of the file. An unterminated line is cut off: it was never acknowledged."""
        if not self.paths.checkpoints.exists():
            return b""
        tail = unterminated_tail(self.paths.checkpoints)
        if tail.torn:
            self._checkpoints.truncate(tail.valid_bytes)
        lines = lines_backwards(self.paths.checkpoints)
        return next((line for line in lines if records.decode_checkpoint(line, None)), b"")

    def _head_line(self) -> bytes:
        """Return the line of the head; b"" where there is none. One that cannot be read counts as changed."""
        try:
            with append_log.open_to_read(self.paths.head) as file:
                return file.read().rstrip(b"\n")
        except FileNotFoundError:
            return b""
        except OSError:
            return b"unreadable"

    def _quarantine_torn(self, tail: TornTail) -> None:
        """Move the torn end, which was never acknowledged, into a file of its own and report it."""
        if not tail.torn:
            return
        digest = sha256(tail.torn).hexdigest()
        path = self.paths.folder / f"audit-torn-{digest[:16]}.bin"
        atomic_write_private(path, tail.torn)
        torn = AppendLog(tail.path)
        torn.truncate(tail.valid_bytes)
        torn.close()
        params = {"octets": len(tail.torn), "file": path.name, "sha256": digest}
        self._recovery_entries.append(AuditEntry(what="audit.recovered", params=params))

    def _continue_after(self, files: Sequence[Path]) -> None:
        """Continue after the last valid record. An edited line stays where it is, for ``verify`` to find."""
        for path in reversed(files):
            for line in lines_backwards(path):
                last = records.decode_record(line)
                if last is not None:
                    self._last_number, self._last_hash = last.n, last.hash
                    self._first_number = self._first_record_number()
                    return

    def _first_record_number(self) -> int:
        """Return the number of the current file's first record; the next number if it is empty."""
        try:
            with self.paths.current.open("rb") as file:
                record = records.decode_record(file.readline().rstrip(b"\n"))
        except FileNotFoundError:
            record = None
        return record.n if record else self._last_number + 1

    def append(self, bodies: Sequence[Json]) -> list[int]:
        """Write records durably and return their numbers. Raises OSError; then none of them was written."""
        n, hash, lines = self._last_number, self._last_hash, []
        for body in bodies:
            n += 1
            line, hash = records.encode_record(n, hash, self._checkpoint_number, body)
            lines.append(line)
        self._records.append(b"".join(lines))
        first, self._last_number, self._last_hash, self._changed = self._last_number + 1, n, hash, True
        if self._records.size >= self._max_file_bytes:
            self._rotate()
        return list(range(first, n + 1))

    def _rotate(self) -> None:
        """Rename the full file. If that fails, it keeps growing: no record depends on it."""
        full = self.paths.rotated(self._first_number)
        if full.exists():
            return
        with suppress(OSError):
            self._records.close()
            self.paths.current.rename(full)
            self._first_number = self._last_number + 1
            fsync_directory(self.paths.folder)

    def write_checkpoint(self) -> None:
        """Write a checkpoint if records were written since the last one. Raises OSError."""
        if not self._is_open or not self._changed:
            return
        last = (self._last_number, self._last_hash)
        line, mac = records.encode_checkpoint(
            self._checkpoint_number + 1, last, self._checkpoint_mac, self._now_ms(), self._key
        )
        self._checkpoints.append(line)
        self._checkpoint_number, self._checkpoint_mac, self._changed = self._checkpoint_number + 1, mac, False
        self._unwritten_head = line

    def write_head(self) -> AuditCheckpoint | None:
        """Replace the head by the newest checkpoint, and return it; None if nothing changed. Raises OSError.

        The head is written after the checkpoint: one that is newer than the checkpoint file proves a removal.
        """
        if not self._unwritten_head:
            return None
        atomic_write_private(self.paths.head, self._unwritten_head)
        line, self._unwritten_head = self._unwritten_head[:-1], b""
        return records.decode_checkpoint(line, None)

    def close(self) -> None:
        """Close the files. Idempotent."""
        self._is_open = False
        self._records.close()
        self._checkpoints.close()
