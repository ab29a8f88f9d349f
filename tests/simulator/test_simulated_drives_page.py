"""The reference page names every model, option and line quality in both languages."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivebus.simulator.line_quality import NAMED_QUALITIES
from drivebus.simulator.models.catalog import LOADS, simulated_models, station_option_names

PAGES = Path(__file__).parents[2] / "docs" / "reference"


@pytest.mark.parametrize("page", ["simulated-drives.md", "simulated-drives.zh.md"])
def test_the_page_names_every_model_and_option(page: str) -> None:
    text = (PAGES / page).read_text(encoding="utf-8")
    missing = [
        word
        for word in (*simulated_models(), *LOADS, *station_option_names(), *NAMED_QUALITIES)
        if f"`{word}`" not in text
    ]
    assert missing == []
