"""The one door to asyncpg: a PostgreSQL server, with a loop of its own for each connection's thread.

The tables lie in the schema ``drivebus``, or where the address says (``postgresql://host/name?search_path=north``).
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

from drivebus.plant.historian.sql import Row

CONNECT_S = 5.0
ANSWER_S = 20.0
"""A server that takes longer counts as gone."""
SCHEMA_NAME = "drivebus"


class Busy(Exception):
    """Another service writes to these tables."""


class PostgresDoor:
    """A connection to ``url``; a reader never writes."""

    errors: tuple[type[Exception], ...] = (
        asyncpg.PostgresError,
        asyncpg.InterfaceError,
        OSError,
        TimeoutError,
        ValueError,
        Busy,
    )
    words = {"id": "BIGSERIAL PRIMARY KEY", "bytes": "BYTEA"}

    def __init__(self, url: str, *, reader: bool = False) -> None:
        self._url = url
        self._reader = reader
        self._runner: asyncio.Runner | None = None
        self._open: asyncpg.Connection | None = None

    def connect(self) -> None:
        self._runner = asyncio.Runner()
        self._open = self._wait(asyncpg.connect(self._url, timeout=CONNECT_S, command_timeout=ANSWER_S))
        if "$user" in self.rows("SHOW search_path")[0][0]:
            self.run(f"SET search_path TO {SCHEMA_NAME}")
        if self._reader:
            self.run("SET default_transaction_read_only = on")
            return
        self.run("SET synchronous_commit = on")
        path = self.rows("SHOW search_path")[0][0]
        if not self.rows("SELECT pg_try_advisory_lock(hashtext('drivebus ' || ?))", path)[0][0]:
            raise Busy("another service writes its history to this database")
        if self.rows("SELECT current_schema()")[0][0] is None:
            self.run(f"CREATE SCHEMA IF NOT EXISTS {path}")

    def _wait(self, work: Coroutine[Any, Any, Any]) -> Any:
        if self._runner is None:
            work.close()
            raise asyncpg.InterfaceError("not open")
        return self._runner.run(work)

    @property
    def _database(self) -> asyncpg.Connection:
        if self._open is None:
            raise asyncpg.InterfaceError("not open")
        return self._open

    def close(self) -> None:
        database, self._open = self._open, None
        runner, self._runner = self._runner, None
        if runner is None:
            return
        try:
            if database is not None:
                runner.run(database.close(timeout=CONNECT_S))
        finally:
            runner.close()

    def version(self) -> int:
        made = self.rows("SELECT to_regclass('meta') IS NOT NULL")[0][0]
        return int(self.rows("SELECT value FROM meta WHERE key = 'schema'")[0][0]) if made else 0

    def rows(self, statement: str, *given: Any) -> list[Row]:
        return [tuple(row) for row in self._wait(self._database.fetch(_numbered(statement), *given))]

    def run(self, statement: str, *given: Any) -> int:
        """The server answers ``DELETE 5``, ``INSERT 0 5``."""
        words = str(self._wait(self._database.execute(_numbered(statement), *given))).split()
        return int(words[-1]) if words and words[-1].isdigit() else 0

    def many(self, statement: str, given: Iterable[Row]) -> None:
        self._wait(self._database.executemany(_numbered(statement), given))

    @contextmanager
    def transaction(self, *, writing: bool) -> Iterator[None]:
        self.run("BEGIN" if writing else "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY")
        try:
            yield
            self.run("COMMIT")
        except BaseException:
            if not self._database.is_closed():
                self.run("ROLLBACK")
            raise

    def size_bytes(self) -> int:
        """The packed data with some room for keys; what the server keeps beside is its own."""
        return int(self.rows("SELECT coalesce(sum(octet_length(data) + 100), 0) FROM block")[0][0])

    def tidy(self) -> None:
        """The server's autovacuum does that."""


@cache
def _numbered(statement: str) -> str:
    """``?`` as ``$1``, ``$2`` …"""
    numbers = count(1)
    return sub(r"\?", lambda _: f"${next(numbers)}", statement)
