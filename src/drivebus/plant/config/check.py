"""What a well-formed ``plant.toml`` must still satisfy: names that exist, drives that fit, rules that can hold."""

from __future__ import annotations

from collections.abc import Iterator

from drivebus.plant.config import check_buses, check_drives, check_line, check_places, check_rules, check_words
from drivebus.plant.config.draft import Draft
from drivebus.profiles.complaint import Complaint, Problem


def problems(draft: Draft) -> Iterator[Problem | Complaint]:
    """Everything that does not fit together. Fills in the draft's profiles, links and dialects on the way."""
    draft.read_profiles()
    yield from check_words.problems(draft.raw)
    yield from check_places.problems(draft)
    yield from check_buses.problems(draft)
    yield from check_drives.problems(draft)
    yield from check_line.problems(draft)
    yield from check_rules.problems(draft)
