"""Where the plant leaves what is to be remembered. Never waits: a full queue loses what comes, counts it and marks the
hole, so that no line is drawn across it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from threading import Lock

from drivebus.profiles.model import Text
from drivebus.service.historian.store import Document, EventRow
from drivebus.service.live.views import Sample
from drivebus.values import Quality

MAX_QUEUED_SAMPLES = 200_000
"""Half an hour of 12 drives with 10 signals each second: a full disk found and mended in that time loses nothing."""
MAX_QUEUED_NOTES = 10_000
"""Events and documents."""


@dataclass(slots=True)
class QueuedBatch:
    """What the writer puts into one batch."""

    samples: list[Sample] = field(default_factory=list)
    events: list[EventRow] = field(default_factory=list)
    """Without an id yet."""
    documents: dict[tuple[str, str], Document] = field(default_factory=dict)
    """The last one of each place."""
    labels: dict[str, tuple[str, Text]] = field(default_factory=dict)
    accepted: int = 0
    """Things accepted up to and with these: what a flush waits for."""


class WriteQueue:
    """A bounded queue between the loop's thread and the writer's."""

    def __init__(self, max_samples: int = MAX_QUEUED_SAMPLES, max_notes: int = MAX_QUEUED_NOTES) -> None:
        self._lock = Lock()
        self._max_samples, self._max_notes = max_samples, max_notes
        self._batches: deque[Sequence[Sample]] = deque()
        self._waiting = QueuedBatch()
        self._gaps: dict[str, int] = {}
        self.queued = 0
        """Samples that wait."""
        self.samples = 0
        """Samples taken in so far, marks of holes among them."""
        self.lost_samples = 0
        self.lost_notes = 0
        self.accepted = 0

    def append(self, samples: Iterable[Sample]) -> None:
        batch = tuple(samples)
        with self._lock:
            if self.queued + len(batch) > self._max_samples:
                self._drop(batch)
                return
            if self._gaps:
                batch = (*self._gap_markers(), *batch)
            self._batches.append(batch)
            self.queued += len(batch)
            self.samples += len(batch)
            self.accepted += len(batch)

    def _drop(self, batch: Iterable[Sample]) -> None:
        for sample in batch:
            self.lost_samples += 1
            self._gaps.setdefault(sample.tag, sample.time_ms)

    def _gap_markers(self) -> list[Sample]:
        """A gap for each tag at the first moment that was lost."""
        holes, self._gaps = self._gaps, {}
        return [Sample(tag, time_ms, None, Quality.BAD) for tag, time_ms in holes.items()]

    def put_event(self, event: EventRow) -> None:
        with self._lock:
            if len(self._waiting.events) >= self._max_notes:
                self.lost_notes += 1
                return
            self._waiting.events.append(event)
            self.accepted += 1

    def put_document(self, document: Document) -> None:
        with self._lock:
            place = (document.kind, document.id)
            if place not in self._waiting.documents and len(self._waiting.documents) >= self._max_notes:
                self.lost_notes += 1
                return
            self._waiting.documents[place] = document
            self.accepted += 1

    def set_labels(self, labels: Mapping[str, tuple[str, Text]]) -> None:
        with self._lock:
            self._waiting.labels.update(labels)
            self.accepted += 1

    def take(self, max_samples: int) -> QueuedBatch:
        """Everything that waits, of samples about ``most``."""
        with self._lock:
            taken, self._waiting = self._waiting, QueuedBatch()
            while self._batches and len(taken.samples) < max_samples:
                taken.samples.extend(self._batches.popleft())
            self.queued -= len(taken.samples)
            taken.accepted = self.accepted - self.queued
            return taken


def sample_value(sample: Sample) -> float:
    """NaN for what is no number: a gap."""
    value = sample.value
    return value if value is not None and math.isfinite(value) else math.nan
