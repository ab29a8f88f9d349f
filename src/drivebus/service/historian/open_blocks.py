"""Samples that are durable (in the journal) but not yet in blocks: one buffer a tag, shared by writer and readers.

Samples of one tag are numbered 0, 1, 2 … in the order in which they came. The numbers know nothing of the wall clock:
when it is set back, later samples have later numbers and earlier times, and nothing is lost or put in another place.
"""

from __future__ import annotations

from array import array
from collections.abc import Container, Iterable
from dataclasses import dataclass, field
from threading import Lock

from drivebus.service.historian.blocks import SampleColumns


@dataclass(slots=True)
class TagBuffer:
    """One tag's samples from number ``first`` on."""

    first: int
    oldest_batch: int = 0
    """Journal row that holds sample ``first``."""
    time: array[int] = field(default_factory=lambda: array("q"))
    value: array[float] = field(default_factory=lambda: array("d"))
    quality: bytearray = field(default_factory=bytearray)

    def __len__(self) -> int:
        return len(self.time)

    @property
    def next_number(self) -> int:
        return self.first + len(self.time)

    def samples(self, skip: int = 0) -> SampleColumns:
        return self.time[skip:].tolist(), self.value[skip:].tolist(), bytes(self.quality[skip:])


class OpenBlocks:
    """Every tag's buffer. The writer changes it, readers copy out of it."""

    def __init__(self) -> None:
        self._buffers: dict[int, TagBuffer] = {}
        self._lock = Lock()
        self.total = 0

    def add_tag(self, tag: int, first: int) -> None:
        """Know a tag whose samples before number ``first`` are in blocks."""
        self._buffers[tag] = TagBuffer(first)

    def next_number(self, tag: int) -> int:
        return self._buffers[tag].next_number

    def add(self, batch: int, groups: Iterable[tuple[int, int, SampleColumns]]) -> None:
        """Samples of journal row ``batch``; those already in blocks are skipped (after a restart)."""
        with self._lock:
            for tag, first, (time, value, quality) in groups:
                buffer = self._buffers[tag]
                skip = max(0, buffer.next_number - first)
                if skip >= len(time):
                    continue
                buffer.oldest_batch = buffer.oldest_batch if len(buffer) else batch
                buffer.time.extend(time[skip:])
                buffer.value.extend(value[skip:])
                buffer.quality.extend(quality[skip:])
                self.total += len(time) - skip

    def copy(self, tag: int) -> tuple[int, SampleColumns]:
        """The number of the first and the samples."""
        with self._lock:
            buffer = self._buffers[tag]
            return buffer.first, buffer.samples()

    def drop_compacted(self, tag: int, upto: int) -> None:
        """All before number ``upto`` are in blocks now. A tag nobody began is passed over."""
        with self._lock:
            if (buffer := self._buffers.get(tag)) is None:
                return
            done = min(max(0, upto - buffer.first), len(buffer))
            rest = TagBuffer(max(upto, buffer.first), buffer.oldest_batch)
            rest.time, rest.value, rest.quality = buffer.time[done:], buffer.value[done:], buffer.quality[done:]
            self._buffers[tag] = rest
            self.total -= done

    def oldest_first(self) -> list[tuple[int, int]]:
        """``(tag, how many samples)``, the one that holds the oldest journal row first."""
        held = [(buffer.oldest_batch, -len(buffer), tag) for tag, buffer in self._buffers.items() if len(buffer)]
        return [(tag, -size) for _, size, tag in sorted(held)]

    def oldest_batch(self, without: Container[int] = ()) -> int | None:
        """The oldest journal row that is still needed once the tags ``without`` are in blocks."""
        held = (buffer.oldest_batch for tag, buffer in self._buffers.items() if len(buffer) and tag not in without)
        return min(held, default=None)
