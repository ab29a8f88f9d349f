"""Histories for tests: a small plant's samples, and a historian on each kind of database."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from drivebus.plant.historian import Historian
from drivebus.plant.historian.reader import Numbered
from drivebus.plant.model import HistorySetting
from drivebus.plant.operations import Trend
from drivebus.plant.view import Sample
from drivebus.reading import Quality

NOON = 1_767_268_800_000
"""2026-01-01 12:00 UTC: the beginning of an hour, in the middle of a day."""

Json = dict[str, Any]


def samples(
    values: Iterable[float | None], tag: str = "fan-1.output_frequency", start_ms: int = NOON, step_ms: int = 1000
) -> list[Sample]:
    """One after another; None is a gap."""
    return [
        Sample(tag, start_ms + n * step_ms, value, Quality.BAD if value is None else Quality.GOOD)
        for n, value in enumerate(values)
    ]


class Wall:
    """A wall clock that a test sets."""

    def __init__(self, now_ms: int = NOON) -> None:
        self.now_ms = now_ms

    def __call__(self) -> int:
        return self.now_ms


class Database:
    """One empty database and any number of historians on it, one after another."""

    def __init__(self, name: str, setting: HistorySetting, directory: Path, check: Callable[[], None]) -> None:
        self.name, self.setting, self.directory, self.check = name, setting, directory, check

    def historian(self, setting: HistorySetting | None = None, **more: Any) -> Historian:
        """With a clock of the test's own, the test alone says when a round is."""
        if "wall_ms" in more:
            more["flush_s"] = 1e6
        return Historian(setting or self.setting, self.directory, **more)


def files(folder: Path) -> list[str]:
    return sorted(file.name for file in folder.iterdir())


async def trend(historian: Historian, from_ms: int, to_ms: int, points: int = 1000, tag: str | None = None) -> Json:
    """One tag's series, with ``resolution`` beside its columns."""
    name = tag or "fan-1.output_frequency"
    found = await historian.trend(Trend(tags=[name], from_ms=from_ms, to_ms=to_ms, points=points))
    return {"resolution": found["resolution"], **found["series"][name]}


async def samples_of(historian: Historian, tag: str, from_ms: int, to_ms: int) -> Numbered:
    """A tag's samples with their numbers, in the order of their coming."""
    (id,) = historian.tag_ids([tag]).values()
    found = await historian._read(lambda: historian._reader.samples([id], from_ms, to_ms))
    return found[id]


async def sealed(historian: Historian) -> None:
    """Everything in blocks, as after hours of running."""
    await historian.flush()
    await historian._write(historian.writer.seal_all)
