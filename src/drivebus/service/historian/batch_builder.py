"""What came in one interval, made ready for one transaction: samples by tag, new tags, events with their numbers."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace

from drivebus.profiles.model import Text
from drivebus.service.historian.blocks import SampleColumns, encode_batch
from drivebus.service.historian.points import CODE_BY_QUALITY
from drivebus.service.historian.store import Batch, StoreContents, Tag
from drivebus.service.historian.write_queue import QueuedBatch, sample_value
from drivebus.service.live.views import Sample


@dataclass(frozen=True, slots=True)
class PendingBatch:
    """A batch on its way, tried again until it is durable."""

    batch: Batch
    groups: list[tuple[int, int, SampleColumns]]
    """Tag, number of the first, samples."""
    accepted: int
    """What the intake had accepted up to and with it."""


class BatchBuilder:
    """Knows every tag and the last numbers."""

    def __init__(self) -> None:
        self.tags: dict[str, Tag] = {}
        self.last_batch = 0
        """Number of the last journal row."""
        self._last_event = 0
        self._labels: dict[str, tuple[str, Text]] = {}

    def resume(self, contents: StoreContents) -> None:
        """Go on where a store ends."""
        self.tags = {tag.name: tag for tag in contents.tags}
        self._last_event = contents.last_event

    def build(self, taken: QueuedBatch, following: Callable[[int], int]) -> PendingBatch:
        """``following``: a known tag → the number of its next sample."""
        by_tag: defaultdict[str, list[Sample]] = defaultdict(list)
        for sample in taken.samples:
            by_tag[sample.tag].append(sample)
        tags = self._changed_tags(list(by_tag), taken)
        new = {tag.name: tag.id for tag in tags if tag.name not in self.tags}
        groups = []
        for name, samples in by_tag.items():
            tag, first = (new[name], 0) if name in new else (self.tags[name].id, following(self.tags[name].id))
            groups.append((tag, first, _sample_columns(samples)))
        events = [replace(event, id=self._last_event + n) for n, event in enumerate(taken.events, 1)]
        packed = encode_batch(groups) if groups else None
        batch = Batch(self.last_batch + 1, packed, tags, events, list(taken.documents.values()))
        return PendingBatch(batch, groups, taken.accepted)

    def _changed_tags(self, names: list[str], taken: QueuedBatch) -> list[Tag]:
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

    def confirm(self, batch: Batch) -> None:
        """It is durable."""
        self.tags |= {tag.name: tag for tag in batch.tags}
        self.last_batch = batch.id
        self._last_event += len(batch.events)


def _sample_columns(samples: list[Sample]) -> SampleColumns:
    time_ms = [sample.time_ms for sample in samples]
    return (
        time_ms,
        [sample_value(sample) for sample in samples],
        bytes([CODE_BY_QUALITY[sample.quality] for sample in samples]),
    )
