"""Buses and drives: links, lines, addresses, models, settings, limits, and what their polls cost."""

from __future__ import annotations

from collections.abc import Iterator

from drivebus.drives.make import make_dialect
from drivebus.errors import ConfigurationError
from drivebus.plant.config.draft import Draft
from drivebus.plant.config.polling import with_periods
from drivebus.profiles.complaint import Complaint, Problem


def problems(draft: Draft) -> Iterator[Problem | Complaint]:
    for id, one in draft.file.drive.items():
        if id in draft.profiles:
            profile = with_periods(draft.profiles[id], one.signals)
            try:
                draft.dialects[id] = make_dialect(profile, one.address, encoding=one.encoding, settings=one.settings)
            except ConfigurationError:
                continue
    yield from ()
