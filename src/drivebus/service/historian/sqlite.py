"""Connection to an SQLite file: WAL mode, every commit synced. The only module that imports sqlite3."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from drivebus.errors import SystemReason
from drivebus.service.historian.store import SqlRow, StoreError
from drivebus.values import Text, bilingual_text

VACUUM_PAGES = 1000
"""Free pages returned at a time: some milliseconds."""
PRIMARY_RESULT_MASK = 0xFF
"""The low byte of a result code of SQLite is its kind; the others name the call that failed."""
FAILURES = {
    sqlite3.SQLITE_FULL: "history.file_full",
    sqlite3.SQLITE_READONLY: "history.file_read_only",
    sqlite3.SQLITE_PERM: "history.file_read_only",
    sqlite3.SQLITE_CANTOPEN: "history.file_not_opened",
    sqlite3.SQLITE_IOERR: "history.file_io",
    sqlite3.SQLITE_CORRUPT: "history.file_damaged",
    sqlite3.SQLITE_NOTADB: "history.file_damaged",
    sqlite3.SQLITE_BUSY: "history.file_locked",
    sqlite3.SQLITE_LOCKED: "history.file_locked",
}
"""Sentence of each result code that a user can do something about."""


class SqliteConnection:
    """Connection to the file ``path``. A reader is read-only."""

    errors: tuple[type[Exception], ...] = (sqlite3.Error, OSError)
    type_names = {"id": "INTEGER PRIMARY KEY", "bytes": "BLOB"}

    def __init__(self, path: Path, *, reader: bool = False) -> None:
        self.path = path
        self._reader = reader
        self._connection: sqlite3.Connection | None = None
        self._written_file: tuple[int, int] | None = None
        """Device and inode of the file that the writer opened first."""

    def reason(self, error: Exception) -> Text:
        """Return why SQLite or the operating system failed."""
        if isinstance(error, OSError):
            return Text.per_language(SystemReason(error).text)
        code = getattr(error, "sqlite_errorcode", 0) & PRIMARY_RESULT_MASK
        key = FAILURES.get(code, "history.database_error")
        return bilingual_text(key, file=self.path.name, detail=str(error) or type(error).__name__)

    def connect(self) -> None:
        if not self._reader:
            self._check_same_file()
            self.path.touch(mode=0o600)
            self._written_file = self._file_identity()
        where = f"{self.path.absolute().as_uri()}?mode={'ro' if self._reader else 'rw'}"
        self._connection = sqlite3.connect(where, uri=True, isolation_level=None, timeout=5.0)
        # Debian's build overwrites deleted data; a history has no secrets, and journal rows are deleted all the time.
        pragmas = ["secure_delete = OFF"]
        if not self._reader:
            pragmas += ["auto_vacuum = INCREMENTAL", "journal_mode = WAL", "synchronous = FULL"]
        for pragma in pragmas:
            self.fetch(f"PRAGMA {pragma}")

    def _file_identity(self) -> tuple[int, int] | None:
        """Return device and inode of the file; None where there is none."""
        try:
            status = self.path.stat()
        except FileNotFoundError:
            return None
        return status.st_dev, status.st_ino

    def _check_same_file(self) -> None:
        """Raise StoreError where the writer's file was removed or replaced.

        SQLite would go on with the removed file, which nothing reads, and another one lacks the tags of the writer.
        """
        if self._written_file is not None and self._file_identity() != self._written_file:
            raise StoreError(bilingual_text("history.file_replaced", file=self.path.name))

    @property
    def _connected(self) -> sqlite3.Connection:
        if self._connection is None:
            raise sqlite3.ProgrammingError("not open")
        return self._connection

    def close(self) -> None:
        if self._connection is not None:
            database, self._connection = self._connection, None
            database.close()

    def version(self) -> int:
        has_tables = self.fetch("SELECT count(*) FROM sqlite_master WHERE name = 'meta'")[0][0]
        return int(self.fetch("SELECT value FROM meta WHERE key = 'schema'")[0][0]) if has_tables else 0

    def fetch(self, statement: str, *values: Any) -> list[SqlRow]:
        return self._connected.execute(statement, values).fetchall()

    def execute(self, statement: str, *values: Any) -> int:
        return self._connected.execute(statement, values).rowcount

    def execute_many(self, statement: str, rows: Iterable[SqlRow]) -> None:
        self._connected.executemany(statement, rows)

    @contextmanager
    def transaction(self, *, writing: bool) -> Iterator[None]:
        if writing:
            self._check_same_file()
        self.execute("BEGIN IMMEDIATE" if writing else "BEGIN")
        try:
            yield
            self.execute("COMMIT")
        finally:
            if self._connected.in_transaction:
                self.execute("ROLLBACK")

    def size_bytes(self) -> int:
        """Return the size of the pages in use; free pages are reused before the file grows."""
        pages, free, size = (
            self.fetch(f"PRAGMA {name}")[0][0] for name in ("page_count", "freelist_count", "page_size")
        )
        return int((pages - free) * size)

    def vacuum(self) -> None:
        self.fetch(f"PRAGMA incremental_vacuum({VACUUM_PAGES})")
