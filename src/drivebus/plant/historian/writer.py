"""The one writer: makes durable what the intake holds, moves it into blocks, forgets what is too old.

Every method runs on the writer's thread. A store that fails is closed and opened again at the next
round; until then the batch stays in memory and the intake fills, and nobody else notices.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from contextlib import suppress

from drivebus import seams
from drivebus.plant.historian import retention
from drivebus.plant.historian.blocks import Damaged, decode_batch
from drivebus.plant.historian.intake import Intake
from drivebus.plant.historian.packing import Packed, Packer
from drivebus.plant.historian.sealing import seal
from drivebus.plant.historian.store import Contents, Seal, Store, StoreError, Tag
from drivebus.plant.historian.unsealed import Unsealed
from drivebus.plant.model import HistorySetting

log = logging.getLogger("drivebus.history")

BATCH = 50_000
"""Samples in one transaction."""
BLOCK = 3600
"""Samples of a tag that make a full block."""
UNSEALED = 200_000
UNSEALED_A_TAG = 600
"""The journal holds so many samples, or so many a tag if that is more. Fewer: small blocks; more: a long start."""
TOGETHER = 16
"""Tags sealed in one transaction."""
SEALING_S = 0.25
"""Of one round at most, unless samples come faster than that."""
BREATH_S = 0.0005
"""Between two tags: the bus loops of the same process get the interpreter in between."""
RETENTION_S = 600.0


class Writer:
    """Over a store that nobody else writes to."""

    def __init__(
        self,
        store: Store,
        setting: HistorySetting,
        intake: Intake,
        *,
        wall_ms: Callable[[], int] = seams.wall_ms,
        monotonic_s: Callable[[], float] = time.monotonic,
        breath_s: float = BREATH_S,
    ) -> None:
        self._store, self._setting, self._intake = store, setting, intake
        self._wall_ms, self._monotonic_s, self._breath_s = wall_ms, monotonic_s, breath_s
        self.unsealed = Unsealed()
        self.problem: str | None = None
        """Why nothing can be written now."""
        self.written = 0
        """Things of the intake that are durable."""
        self._packer = Packer()
        self._packed: Packed | None = None
        self._is_open = False
        self._known = False
        """It was open once: what is in memory goes on."""
        self._clock_ms = 0
        self._clock_s = self._retention_s = monotonic_s()

    @property
    def tags(self) -> dict[str, Tag]:
        """Every tag by name."""
        return self._packer.tags

    def round(self) -> None:
        """Once each flush interval. Raises nothing that a database can do."""
        with suppress(StoreError):
            self.write()
            self._seal_ripe()
            self._forget()

    def write(self) -> None:
        """Everything that the intake held at the call is durable on return. Raises StoreError."""
        mark = self._intake.accepted
        self._guarded(self._write_one)
        while self.written < mark:
            self._guarded(self._write_one)

    def close(self) -> None:
        """The last batch, as far as the store takes it."""
        try:
            self.write()
        except StoreError:
            log.error("history that came last is lost: %s", self.problem)
        finally:
            self._is_open = False
            with suppress(StoreError):
                self._store.close()

    def seal_all(self) -> None:
        """Everything into blocks. Raises StoreError."""
        self.write()
        self._guarded(lambda: self._seal([tag for tag, _ in self.unsealed.oldest_first()]))

    def _guarded(self, step: Callable[[], None]) -> None:
        try:
            if not self._is_open:
                self._open()
            step()
        except (StoreError, Damaged) as error:
            self._failed(error)
            raise StoreError(str(error)) from error
        if self.problem is not None:
            self.problem = None
            log.warning("history is written again; samples lost: %d", self._intake.lost_samples)

    def _failed(self, error: Exception) -> None:
        self._is_open = False
        if self.problem is None:
            log.error("history can't be written: %s", error)
        self.problem = str(error)
        with suppress(StoreError):
            self._store.close()

    def _open(self) -> None:
        contents = self._store.open()
        if self._known:
            for tag in contents.tags:
                self.unsealed.sealed(tag.id, tag.sealed)
        else:
            self._replay(contents)
            self._clock_ms, self._clock_s = retention.at_start(contents.clock, self._wall_ms()), self._monotonic_s()
        self._is_open = self._known = True

    def _replay(self, contents: Contents) -> None:
        """After a start: what was durable and is not in blocks yet."""
        self.unsealed = Unsealed()
        self._packer.begin(contents)
        for tag in contents.tags:
            self.unsealed.begin(tag.id, tag.sealed)
        for batch, data in self._store.journal():
            self.unsealed.add(batch, decode_batch(data))
            self._packer.batch = batch

    def _write_one(self) -> None:
        if self._packed is None:
            self._packed = self._packer.pack(self._intake.take(BATCH), self.unsealed.next)
        packed, batch = self._packed, self._packed.batch
        if batch.samples or batch.tags or batch.events or batch.documents:
            self._store.put(batch)
        for tag in batch.tags:
            if tag.name not in self.tags:
                self.unsealed.begin(tag.id, 0)
        self._packer.done(batch)
        self.unsealed.add(batch.id, packed.groups)
        self.written = packed.accepted
        self._packed = None

    def _seal_ripe(self) -> None:
        most = max(UNSEALED, UNSEALED_A_TAG * len(self.tags))
        until = self._monotonic_s() + SEALING_S
        while ripe := self._ripe(most):
            self._guarded(lambda ripe=ripe: self._seal(ripe))  # type: ignore[misc]
            if self.unsealed.total < 2 * most and self._monotonic_s() > until:
                return

    def _ripe(self, most: int) -> list[int]:
        """Tags with a full block, and those that keep the oldest journal rows while there are too many."""
        over, ripe = self.unsealed.total - most, []
        for tag, size in self.unsealed.oldest_first():
            if size >= BLOCK or over > 0:
                ripe.append(tag)
                over -= size
        return ripe[:TOGETHER]

    def _seal(self, tags: list[int]) -> None:
        for at in range(0, len(tags), TOGETHER):
            part = tags[at : at + TOGETHER]
            seals = [self._sealed(tag) for tag in part]
            self._store.seal(seals, self._now_ms(), self.unsealed.oldest_batch(without=set(part)))
            for one in seals:
                self.unsealed.sealed(one.tag, one.to_number)

    def _sealed(self, tag: int) -> Seal:
        first, samples = self.unsealed.copy(tag)
        time.sleep(self._breath_s)
        return seal(tag, first, samples, self._store.block)

    def _now_ms(self) -> int:
        """The clock of age."""
        return self._clock_ms + round(1000 * (self._monotonic_s() - self._clock_s))

    def _forget(self) -> None:
        if self._monotonic_s() < self._retention_s:
            return
        self._guarded(self._forget_some)

    def _forget_some(self) -> None:
        now_ms = self._now_ms()
        self._store.keep_clock(now_ms, self._wall_ms())
        more = [rule(self._store, self._setting, now_ms) for rule in (retention.by_age, retention.by_size)]
        self._retention_s = self._monotonic_s() + (0.0 if any(more) else RETENTION_S)
