"""What people are told of a frame stays what it was: fields, problems, errata, hazards, candidates, canonical bytes."""

from __future__ import annotations

from typing import Any

import pytest

from fixtures.describe_snapshots import describe_snapshot, load_snapshots

LINES = load_snapshots()


@pytest.mark.parametrize("line", LINES, ids=lambda line: f"{line['family']} {line['hex'][:40]}")
def test_a_frame_is_told_as_it_was(line: dict[str, Any]) -> None:
    assert describe_snapshot(line) == line["told"]


def test_every_kind_of_note_of_the_protocols_is_among_them() -> None:
    """Else a changed sentence key would not be seen."""
    seen = {
        note[0] for line in LINES for place in ("problems", "errata", "hazards") for note in line["told"].get(place, ())
    }
    seen |= {reading["note"][0] for line in LINES for reading in line["told"].get("readings", ())}
    assert len(seen) > 60, sorted(seen)
