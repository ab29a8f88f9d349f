"""The committed report of the whole comparison says what its run found."""

from __future__ import annotations

import json

import pytest

from oracle.__main__ import REPORT, rows


@pytest.mark.parametrize("page", ["reference-codec-comparison.md", "reference-codec-comparison.zh.md"])
def test_the_pages_show_the_figures_of_the_committed_run(page: str) -> None:
    text = (REPORT.parent / page).read_text(encoding="utf-8")
    found = json.loads(REPORT.read_text(encoding="utf-8"))
    assert [row for row in rows(found) if row not in text] == []
    assert found["commit"] in text
