"""A command whose question is answered with no does nothing and ends as at Ctrl-C; see also test_calibrate.py."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from drivebus.cli.commands import comm_loss_test
from drivebus.cli.errors import ExitCode


def test_a_declined_comm_loss_test_starts_nothing_and_ends_with_130(monkeypatch: pytest.MonkeyPatch) -> None:
    """Regression: it ended with 0, as a test that found a drive to stop by itself."""
    called: list[str] = []

    class Client:
        @staticmethod
        async def call(name: str, _: Any) -> Any:
            called.append(name)
            return {"address": 1, "model": "c320", "comm_loss": {"tested": None, "test": None}}

    @asynccontextmanager
    async def open_client(_: str) -> AsyncIterator[Client]:
        yield Client()

    monkeypatch.setattr("drivebus.cli.remote.client.open_client", open_client)
    monkeypatch.setattr(comm_loss_test, "confirm", lambda _: False)
    test = comm_loss_test._connect_and_test("http://127.0.0.1:1", "fan-2", 5.0, None, yes=False)
    assert asyncio.run(test) is ExitCode.INTERRUPTED
    assert called == ["drives.get"]
