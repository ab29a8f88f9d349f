"""Reads beside the writer, with a connection and a thread of its own: what is in blocks and what is only durable yet.

The samples that are not in blocks are copied first, the database is looked at once after that. A tag's ``sealed``
number of that look tells which of the copies became blocks in between, so that none is missing and none counts twice.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from drivebus.plant.historian import blocks
from drivebus.plant.historian.blocks import Damaged, Samples
from drivebus.plant.historian.levels import GRAINS, Level
from drivebus.plant.historian.points import Points, between, of_samples, roll, together
from drivebus.plant.historian.store import Block, Store, StoreError
from drivebus.plant.historian.unsealed import Unsealed


@dataclass(frozen=True, slots=True)
class Numbered:
    """Samples of a tag with the numbers in the order of their coming."""

    number: list[int]
    samples: Samples


class Reader:
    """All methods but the constructor run on the reader's thread and raise StoreError."""

    def __init__(self, store: Store, unsealed: Callable[[], Unsealed]) -> None:
        self._store = store
        self._unsealed = unsealed
        self._is_open = False

    @property
    def store(self) -> Store:
        """Open."""
        if not self._is_open:
            self._store.open()
            self._is_open = True
        return self._store

    def close(self) -> None:
        self._is_open = False
        self._store.close()

    def rolled(self, level: Level, tags: Sequence[int], from_ms: int, to_ms: int) -> Iterator[tuple[int, Points]]:
        """Tag after tag, every point that begins within, or (rollups) that ``from_ms`` lies in; in order.

        Only one tag's points are in memory at a time: with ten, getting that memory took as long as the work.
        """
        width = GRAINS[level].width_ms
        first = from_ms if level is Level.RAW else from_ms // width * width
        fresh, rows = self._look(level, tags, from_ms, to_ms)
        stored: dict[int, list[Block]] = {tag: [] for tag in tags}
        for row in rows:
            stored[row.tag].append(row)
        for tag, (_, samples) in fresh.items():
            points = of_samples(*samples)
            pieces = [*map(_points, stored[tag]), points if level is Level.RAW else roll(points, width)]
            yield tag, between(together(pieces), first, to_ms)

    def samples(self, tags: Sequence[int], from_ms: int, to_ms: int) -> dict[int, Numbered]:
        """Samples with their numbers, in the order of their coming."""
        found = {tag: Numbered([], ([], [], b"")) for tag in tags}
        fresh, rows = self._look(Level.RAW, tags, from_ms, to_ms)
        runs = [(row.tag, row.number, blocks.decode_samples(row.start_ms, row.data)) for row in rows]
        for tag, first, samples in sorted([*runs, *((tag, *one) for tag, one in fresh.items())], key=_place):
            found[tag] = _with(found[tag], first, samples, from_ms, to_ms)
        return found

    def following(self, level: Level, tags: Sequence[int], from_ms: int) -> int | None:
        """The first partition that begins at ``from_ms`` or later and holds any of these tags."""
        length = GRAINS[level].partition_ms
        times = (time for tag in tags for time in self._unsealed().copy(tag)[1][0])
        fresh = [start for start in {time // length * length for time in times} if start >= from_ms]
        stored = self.store.following(level, tags, from_ms)
        return min(fresh if stored is None else [*fresh, stored], default=None)

    def _look(
        self, level: Level, tags: Sequence[int], from_ms: int, to_ms: int
    ) -> tuple[dict[int, tuple[int, Samples]], list[Block]]:
        fresh = {tag: self._unsealed().copy(tag) for tag in tags}
        length = GRAINS[level].partition_ms
        sealed, rows = self.store.read(level, tags, from_ms // length * length, to_ms)
        return {tag: _from(first, samples, sealed.get(tag, 0)) for tag, (first, samples) in fresh.items()}, rows


def _place(run: tuple[int, int, Samples]) -> tuple[int, int]:
    return run[0], run[1]


def _from(first: int, samples: Samples, sealed: int) -> tuple[int, Samples]:
    """Without those before number ``sealed``."""
    skip = max(0, sealed - first)
    time, value, quality = samples
    return first + skip, (time[skip:], value[skip:], quality[skip:])


def _points(row: Block) -> Points:
    try:
        if row.level is Level.RAW:
            return of_samples(*blocks.decode_samples(row.start_ms, row.data))
        return blocks.decode_points(row.start_ms, GRAINS[row.level].width_ms, row.data)
    except Damaged as error:
        raise StoreError(f"block {row.level} {row.tag} {row.start_ms}: {error}") from error


def _with(found: Numbered, first: int, samples: Samples, from_ms: int, to_ms: int) -> Numbered:
    time, value, quality = samples
    wanted = [n for n, moment in enumerate(time) if from_ms <= moment <= to_ms]
    number = found.number + [first + n for n in wanted]
    times, values = found.samples[0] + [time[n] for n in wanted], found.samples[1] + [value[n] for n in wanted]
    return Numbered(number, (times, values, found.samples[2] + bytes([quality[n] for n in wanted])))
