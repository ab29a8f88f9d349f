"""Connection to a PostgreSQL server, with an event loop of its own. The only module that imports asyncpg.

The tables are in the schema ``drivebus``, or in the one that the URL names
(``postgresql://host/name?search_path=north``).
"""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine, Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from itertools import count
from re import sub
from typing import Any

import asyncpg  # type: ignore[import-untyped]

from drivebus.errors import SystemReason
from drivebus.service.config.database import default_sslmode
from drivebus.service.historian.store import SqlRow, StoreError
from drivebus.values import Text, bilingual_text

POSTGRES_CONNECT_TIMEOUT_S = 5.0
POSTGRES_QUERY_TIMEOUT_S = 20.0
"""A query that takes longer counts as a lost connection."""
POSTGRES_SCHEMA = "drivebus"
FAILURES = {
    "08": "history.connection_lost",
    "25006": "history.server_read_only",
    "28": "history.login_rejected",
    "3D": "history.no_database",
    "42501": "history.no_right",
    "53100": "history.server_full",
    "53300": "history.server_busy",
    "57P": "history.server_stopping",
}
"""Sentence of each SQLSTATE, by its start, that a user can do something about."""


class PostgresConnection:
    """Connection to ``url``. A reader is read-only."""

    errors: tuple[type[Exception], ...] = (
        asyncpg.PostgresError,
        asyncpg.InterfaceError,
        OSError,
        TimeoutError,
        ValueError,
    )
    type_names = {"id": "BIGSERIAL PRIMARY KEY", "bytes": "BYTEA"}

    def __init__(self, url: str, *, reader: bool = False) -> None:
        self._url = url
        self._reader = reader
        self._runner: asyncio.Runner | None = None
        self._connection: asyncpg.Connection | None = None

    def reason(self, error: Exception) -> Text:
        """Return why the server or the connection to it failed."""
        detail = str(error) or type(error).__name__
        if isinstance(error, TimeoutError):
            return bilingual_text("history.no_answer")
        if isinstance(error, OSError):
            return bilingual_text("history.unreachable", detail=SystemReason(error))
        if isinstance(error, asyncpg.InterfaceError):
            return bilingual_text("history.connection_lost")
        sqlstate = str(getattr(error, "sqlstate", None) or "")
        key = next((key for start, key in FAILURES.items() if sqlstate.startswith(start)), "history.database_error")
        return bilingual_text(key, detail=detail)

    def connect(self) -> None:
        self._runner = asyncio.Runner()
        self._connection = self._run_coroutine(
            asyncpg.connect(
                self._url,
                ssl=default_sslmode(self._url),
                timeout=POSTGRES_CONNECT_TIMEOUT_S,
                command_timeout=POSTGRES_QUERY_TIMEOUT_S,
            )
        )
        if "$user" in self.fetch("SHOW search_path")[0][0]:
            self.execute(f"SET search_path TO {POSTGRES_SCHEMA}")
        if self._reader:
            self.execute("SET default_transaction_read_only = on")
            return
        self.execute("SET synchronous_commit = on")
        path = self.fetch("SHOW search_path")[0][0]
        if not self.fetch("SELECT pg_try_advisory_lock(hashtext('drivebus ' || ?))", path)[0][0]:
            raise StoreError(bilingual_text("history.in_use"))
        if self.fetch("SELECT current_schema()")[0][0] is None:
            self.execute(f"CREATE SCHEMA IF NOT EXISTS {path}")

    def _run_coroutine(self, work: Coroutine[Any, Any, Any]) -> Any:
        if self._runner is None:
            work.close()
            raise asyncpg.InterfaceError("not open")
        return self._runner.run(work)

    @property
    def _connected(self) -> asyncpg.Connection:
        if self._connection is None:
            raise asyncpg.InterfaceError("not open")
        return self._connection

    def close(self) -> None:
        database, self._connection = self._connection, None
        runner, self._runner = self._runner, None
        if runner is None:
            return
        try:
            if database is not None:
                runner.run(database.close(timeout=POSTGRES_CONNECT_TIMEOUT_S))
        finally:
            runner.close()

    def version(self) -> int:
        has_tables = self.fetch("SELECT to_regclass('meta') IS NOT NULL")[0][0]
        return int(self.fetch("SELECT value FROM meta WHERE key = 'schema'")[0][0]) if has_tables else 0

    def fetch(self, statement: str, *values: Any) -> list[SqlRow]:
        return [tuple(row) for row in self._run_coroutine(self._connected.fetch(_numbered(statement), *values))]

    def execute(self, statement: str, *values: Any) -> int:
        """Execute a statement; the status ``DELETE 5`` or ``INSERT 0 5`` holds the number of rows."""
        words = str(self._run_coroutine(self._connected.execute(_numbered(statement), *values))).split()
        return int(words[-1]) if words and words[-1].isdigit() else 0

    def execute_many(self, statement: str, rows: Iterable[SqlRow]) -> None:
        self._run_coroutine(self._connected.executemany(_numbered(statement), rows))

    @contextmanager
    def transaction(self, *, writing: bool) -> Iterator[None]:
        self.execute("BEGIN" if writing else "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY")
        try:
            yield
            self.execute("COMMIT")
        except BaseException:
            if not self._connected.is_closed():
                self.execute("ROLLBACK")
            raise

    def size_bytes(self) -> int:
        """Return the size of the packed data with an allowance for keys."""
        return int(self.fetch("SELECT coalesce(sum(octet_length(data) + 100), 0) FROM block")[0][0])

    def vacuum(self) -> None:
        """Do nothing: the server has autovacuum."""


@cache
def _numbered(statement: str) -> str:
    """Replace ``?`` by ``$1``, ``$2`` …"""
    numbers = count(1)
    return sub(r"\?", lambda _: f"${next(numbers)}", statement)
