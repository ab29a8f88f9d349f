"""Every test of the commands starts with English text; commands on simulated drives can run in virtual time."""

from __future__ import annotations

import pytest

from drivebus.testing import virtual_time


@pytest.fixture(autouse=True)
def english(english_output: None) -> None:
    """Use ``english_output`` in every test of this folder."""


@pytest.fixture
def commands_in_virtual_time(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run the commands of this process in virtual time, where a loaded machine makes no reply late.

    Not in a test whose bus is behind a socket.
    """
    if "polled_line" not in request.fixturenames:
        monkeypatch.setattr("asyncio.run", virtual_time.run)
