"""Where the plant leaves what is to be remembered. Never waits: a full queue loses what comes, counts it and marks the
hole, so that no line is drawn across it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from threading import Lock

from drivebus.plant.historian.store import Document, EventRow
from drivebus.plant.view import Sample
from drivebus.profiles.model import Text
from drivebus.reading import Quality

SAMPLES = 200_000
"""Half an hour of 12 drives with 10 signals each second: a full disk found and mended in that time loses nothing."""
NOTES = 10_000
"""Events and documents."""


@dataclass(slots=True)
class Taken:
    """What the writer puts into one batch."""

    samples: list[Sample] = field(default_factory=list)
    events: list[EventRow] = field(default_factory=list)
    """Without an id yet."""
    documents: dict[tuple[str, str], Document] = field(default_factory=dict)
    """The last one of each place."""
    labels: dict[str, tuple[str, Text]] = field(default_factory=dict)
    accepted: int = 0
    """Things accepted up to and with these: what a flush waits for."""


class Intake:
    """A bounded queue between the loop's thread and the writer's."""

    def __init__(self, samples: int = SAMPLES, notes: int = NOTES) -> None:
        self._lock = Lock()
        self._most_samples, self._most_notes = samples, notes
        self._batches: deque[Sequence[Sample]] = deque()
        self._waiting = Taken()
        self._holes: dict[str, int] = {}
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
            if self.queued + len(batch) > self._most_samples:
                self._lose(batch)
                return
            if self._holes:
                batch = (*self._marked(), *batch)
            self._batches.append(batch)
            self.queued += len(batch)
            self.samples += len(batch)
            self.accepted += len(batch)

    def _lose(self, batch: Iterable[Sample]) -> None:
        for sample in batch:
            self.lost_samples += 1
            self._holes.setdefault(sample.tag, sample.time_ms)

    def _marked(self) -> list[Sample]:
        """A gap for each tag at the first moment that was lost."""
        holes, self._holes = self._holes, {}
        return [Sample(tag, time_ms, None, Quality.BAD) for tag, time_ms in holes.items()]

    def put_event(self, event: EventRow) -> None:
        with self._lock:
            if len(self._waiting.events) >= self._most_notes:
                self.lost_notes += 1
                return
            self._waiting.events.append(event)
            self.accepted += 1

    def put_document(self, document: Document) -> None:
        with self._lock:
            place = (document.kind, document.id)
            if place not in self._waiting.documents and len(self._waiting.documents) >= self._most_notes:
                self.lost_notes += 1
                return
            self._waiting.documents[place] = document
            self.accepted += 1

    def label(self, labels: Mapping[str, tuple[str, Text]]) -> None:
        with self._lock:
            self._waiting.labels.update(labels)
            self.accepted += 1

    def take(self, most: int) -> Taken:
        """Everything that waits, of samples about ``most``."""
        with self._lock:
            taken, self._waiting = self._waiting, Taken()
            while self._batches and len(taken.samples) < most:
                taken.samples.extend(self._batches.popleft())
            self.queued -= len(taken.samples)
            taken.accepted = self.accepted - self.queued
            return taken


def number(sample: Sample) -> float:
    """NaN for what is no number: a gap."""
    value = sample.value
    return value if value is not None and math.isfinite(value) else math.nan
