"""``database``: the same test on every kind of database."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivebus.plant.model import HistorySetting
from historykit import Database


def _sqlite(tmp_path: Path) -> Database:
    def check() -> None:
        database = sqlite3.connect(tmp_path / "history.db")
        assert database.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        database.close()

    return Database("sqlite", HistorySetting(), tmp_path, check)


@pytest.fixture(params=["sqlite"])
def database(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Database]:
    found = _sqlite(tmp_path)
    yield found
    found.check()
