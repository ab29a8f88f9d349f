"""Every test of the commands starts with English text."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True)
def english(english_output: None) -> None:
    """Use ``english_output`` in every test of this folder."""
