"""What came in one interval, made ready for one transaction: samples by tag, new tags, events with their numbers."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace

from drivebus.plant.historian.blocks import Samples, encode_batch
from drivebus.plant.historian.intake import Taken, number
from drivebus.plant.historian.points import CODES
from drivebus.plant.historian.store import Batch, Contents, Tag
from drivebus.plant.view import Sample
from drivebus.profiles.model import Text


@dataclass(frozen=True, slots=True)
class Packed:
    """A batch on its way, tried again until it is durable."""

    batch: Batch
    groups: list[tuple[int, int, Samples]]
    """Tag, number of the first, samples."""
    accepted: int
    """What the intake had accepted up to and with it."""


class Packer:
    """Knows every tag and the last numbers."""

    def __init__(self) -> None:
        self.tags: dict[str, Tag] = {}
        self.batch = 0
        """Number of the last journal row."""
        self._event = 0
        self._labels: dict[str, tuple[str, Text]] = {}

    def begin(self, contents: Contents) -> None:
        """Go on where a store ends."""
        self.tags = {tag.name: tag for tag in contents.tags}
        self._event = contents.last_event

    def pack(self, taken: Taken, following: Callable[[int], int]) -> Packed:
        """``following``: a known tag → the number of its next sample."""
        by_tag: defaultdict[str, list[Sample]] = defaultdict(list)
        for sample in taken.samples:
            by_tag[sample.tag].append(sample)
        tags = self._changed(list(by_tag), taken)
        new = {tag.name: tag.id for tag in tags if tag.name not in self.tags}
        groups = []
        for name, samples in by_tag.items():
            tag, first = (new[name], 0) if name in new else (self.tags[name].id, following(self.tags[name].id))
            groups.append((tag, first, _columns(samples)))
        events = [replace(event, id=self._event + n) for n, event in enumerate(taken.events, 1)]
        packed = encode_batch(groups) if groups else None
        batch = Batch(self.batch + 1, packed, tags, events, list(taken.documents.values()))
        return Packed(batch, groups, taken.accepted)

    def _changed(self, names: list[str], taken: Taken) -> list[Tag]:
        """Tags that are new, or that have another unit or text now."""
        found = []
        self._labels.update(taken.labels)
        free = 1 + max((tag.id for tag in self.tags.values()), default=0)
        for name in dict.fromkeys([*names, *(name for name in taken.labels if name in self.tags)]):
            tag = self.tags.get(name) or Tag(free, name)
            free += tag.id == free
            if name in self._labels:
                unit, text = self._labels[name]
                tag = replace(tag, unit=unit, en=text.en, zh=text.zh)
            if self.tags.get(name) != tag:
                found.append(tag)
        return found

    def done(self, batch: Batch) -> None:
        """It is durable."""
        self.tags |= {tag.name: tag for tag in batch.tags}
        self.batch = batch.id
        self._event += len(batch.events)


def _columns(samples: list[Sample]) -> Samples:
    time_ms = [sample.time_ms for sample in samples]
    return time_ms, [number(sample) for sample in samples], bytes([CODES[sample.quality] for sample in samples])
