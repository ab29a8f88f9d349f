"""Every test of the commands starts with English text, whatever another one has set."""

from __future__ import annotations

import pytest

from drivebus.cli import output


@pytest.fixture(autouse=True)
def english() -> None:
    output.parse_global_options(["--lang", "en"])
