"""What a well-formed ``plant.toml`` must still satisfy: names that exist, drives that fit, rules that can hold."""

from __future__ import annotations

from collections.abc import Iterator

from drivebus.profiles.diagnostics import Diagnostic, Issue
from drivebus.service.config import check_bus_load, check_buses, check_drives, check_paths, check_rules, check_text
from drivebus.service.config.parsed import ParsedPlant


def all_problems(draft: ParsedPlant) -> Iterator[Issue | Diagnostic]:
    """Everything that does not fit together. Fills in the draft's profiles, links and dialects on the way."""
    draft.read_profiles()
    yield from check_text.text_problems(draft.raw)
    yield from check_paths.path_problems(draft)
    yield from check_buses.bus_problems(draft)
    yield from check_drives.drive_problems(draft)
    yield from check_bus_load.bus_load_problems(draft)
    yield from check_rules.rule_problems(draft)
