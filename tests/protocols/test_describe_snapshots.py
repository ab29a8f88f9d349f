"""Descriptions of frames stay as they were: fields, problems, errata, hazards, interpretations, canonical bytes."""

from __future__ import annotations

from typing import Any

import pytest

from fixtures.describe_snapshots import describe_snapshot, load_snapshots

LINES = load_snapshots()


@pytest.mark.parametrize("line", LINES, ids=lambda line: f"{line['family']} {line['hex'][:40]}")
def test_a_frame_is_described_as_before(line: dict[str, Any]) -> None:
    assert describe_snapshot(line) == line["description"]


def test_the_snapshots_have_every_kind_of_note() -> None:
    """A changed text key is noticed only in a snapshot that has it."""
    found = [line["description"] for line in LINES]
    keys = {note[0] for each in found for place in ("problems", "errata", "hazards") for note in each.get(place, ())}
    keys |= {each["note"][0] for description in found for each in description.get("interpretations", ())}
    assert len(keys) > 60, sorted(keys)
