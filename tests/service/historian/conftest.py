"""Fixture ``database``: runs a test on every kind of database."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from itertools import count
from pathlib import Path

import pytest

import fixtures.postgres as postgreskit
from drivebus.service.config.model import HistoryConfig
from fixtures.historian import HistoryDatabase

NUMBERS = count(1)


@pytest.fixture(scope="session")
def postgres() -> Iterator[postgreskit.PostgresServer]:
    with postgreskit.postgres_server() as server:
        server.create("histories")
        yield server


def _sqlite(tmp_path: Path) -> HistoryDatabase:
    def check() -> None:
        if (tmp_path / "history.db").exists():
            database = sqlite3.connect(tmp_path / "history.db")
            assert database.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
            database.close()

    return HistoryDatabase("sqlite", HistoryConfig(), tmp_path, check)


def _postgres(server: postgreskit.PostgresServer, tmp_path: Path) -> HistoryDatabase:
    """Return a database with its own schema, which is created a hundred times as fast as a database."""
    url = f"{server.url('histories')}&search_path=history_{next(NUMBERS)}"
    return HistoryDatabase("postgres", HistoryConfig(url=url), tmp_path, lambda: None)


@pytest.fixture(params=["sqlite", "postgres"])
def database(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[HistoryDatabase]:
    if request.param == "sqlite":
        found = _sqlite(tmp_path)
    else:
        found = _postgres(request.getfixturevalue("postgres"), tmp_path)
    yield found
    found.check()
