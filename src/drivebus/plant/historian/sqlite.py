"""The one door to sqlite3: one file beside the plant's others. WAL, and every commit is synced before it counts."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from drivebus.plant.historian.sql import Row

PAGES = 1000
"""Free pages given back at a time: some milliseconds."""


class SqliteDoor:
    """A connection to ``path``; a reader never writes."""

    errors: tuple[type[Exception], ...] = (sqlite3.Error, OSError)
    words = {"id": "INTEGER PRIMARY KEY", "bytes": "BLOB"}

    def __init__(self, path: Path, *, reader: bool = False) -> None:
        self.path = path
        self._reader = reader
        self._open: sqlite3.Connection | None = None

    def connect(self) -> None:
        if not self._reader:
            self.path.touch(mode=0o600)
        where = f"{self.path.absolute().as_uri()}?mode={'ro' if self._reader else 'rw'}"
        self._open = sqlite3.connect(where, uri=True, isolation_level=None, timeout=5.0)
        # Debian's build overwrites what is deleted; a history has no secrets and the journal is deleted all the time.
        pragmas = ["secure_delete = OFF"]
        if not self._reader:
            pragmas += ["auto_vacuum = INCREMENTAL", "journal_mode = WAL", "synchronous = FULL"]
        for pragma in pragmas:
            self.rows(f"PRAGMA {pragma}")

    @property
    def _database(self) -> sqlite3.Connection:
        if self._open is None:
            raise sqlite3.ProgrammingError("not open")
        return self._open

    def close(self) -> None:
        if self._open is not None:
            database, self._open = self._open, None
            database.close()

    def version(self) -> int:
        made = self.rows("SELECT count(*) FROM sqlite_master WHERE name = 'meta'")[0][0]
        return int(self.rows("SELECT value FROM meta WHERE key = 'schema'")[0][0]) if made else 0

    def rows(self, statement: str, *given: Any) -> list[Row]:
        return self._database.execute(statement, given).fetchall()

    def run(self, statement: str, *given: Any) -> int:
        return self._database.execute(statement, given).rowcount

    def many(self, statement: str, given: Iterable[Row]) -> None:
        self._database.executemany(statement, given)

    @contextmanager
    def transaction(self, *, writing: bool) -> Iterator[None]:
        self.run("BEGIN IMMEDIATE" if writing else "BEGIN")
        try:
            yield
            self.run("COMMIT")
        finally:
            if self._database.in_transaction:
                self.run("ROLLBACK")

    def size_bytes(self) -> int:
        """Pages in use; free ones are used again before the file grows."""
        pages, free, size = (
            self.rows(f"PRAGMA {name}")[0][0] for name in ("page_count", "freelist_count", "page_size")
        )
        return int((pages - free) * size)

    def tidy(self) -> None:
        self.rows(f"PRAGMA incremental_vacuum({PAGES})")
