"""The trail's files as they are written: records in a chain, checkpoints beside it, and what a killed writer left.

No thread and no loop lives here; every function may take as long as a disk does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import Final

from drivebus.files import sync_folder
from drivebus.plant.audit import seal
from drivebus.plant.audit.entry import Entry
from drivebus.plant.audit.files import Places, backwards
from drivebus.plant.audit.tails import Tail, tail_of, unfinished
from drivebus.plant.journal import Journal, write_whole
from drivebus.plant.view import Json

CUT: Final = "audit.cut"
"""What is recorded where records are missing at the start."""
FULL_AT: Final = 16 * 1024 * 1024
"""Octets; then the file is put aside under its number, and the chain goes on in a new one."""


class Chain:
    """The trail of one plant. One writer: the service holds its lock."""

    def __init__(self, places: Places, now_ms: Callable[[], int], full_at: int = FULL_AT) -> None:
        self.places, self._now_ms, self._full_at = places, now_ms, full_at
        self._journal, self._marks = Journal(places.current), Journal(places.checkpoints)
        self._opened = False
        self._found: list[Entry] = []
        self._key = b""
        self._n, self._hash = 0, seal.FIRST
        self._first = 1
        """The number of the first record of the file that is written."""
        self._new = False
        """Something was written since the last checkpoint."""
        self._number, self._mac, self._marked = 0, seal.FIRST, 0
        """Of the last checkpoint: its number, its MAC, the number of its record."""

    def open(self) -> list[Entry]:
        """Make ready, once; what was found that has to be told, as entries to be written. Raises OSError."""
        if self._opened:
            return []
        self._key = self.places.new_key()
        self._last_checkpoint()
        files = self.places.files()
        if files:
            self._put_aside(tail_of(files[-1], self._marked))
        self._go_on(files)
        self._journal.open()
        if self._n < self._marked:
            self._found.append(Entry(CUT, params={"last": self._n, "checkpoint": self._marked}))
        self._opened = True
        found, self._found = self._found, []
        return found

    def _last_checkpoint(self) -> None:
        """Go on after it. What a killed writer left of its last line is taken away: it was no checkpoint yet."""
        if not self.places.checkpoints.exists():
            return
        tail = unfinished(self.places.checkpoints)
        if tail.rest:
            self._marks.cut(tail.ended)
        lines = (seal.checkpoint(line, None) for line in backwards(self.places.checkpoints))
        last = next((one for one in lines if one is not None), None)
        if last is not None:
            self._number, self._mac, self._marked = last.number, last.mac, last.n

    def _put_aside(self, tail: Tail) -> None:
        """What was never acknowledged: kept in a file of its own, and said."""
        if not tail.rest:
            return
        digest = sha256(tail.rest).hexdigest()
        path = self.places.folder / f"audit-torn-{digest[:16]}.bin"
        write_whole(path, tail.rest)
        torn = Journal(tail.path)
        torn.cut(tail.ended)
        torn.close()
        params = {"octets": len(tail.rest), "file": path.name, "sha256": digest}
        self._found.append(Entry("audit.recovered", params=params))

    def _go_on(self, files: Sequence[Path]) -> None:
        """After the last record that there is, whole or not: a line that was changed stays for ``verify`` to find."""
        for path in reversed(files):
            for line in backwards(path):
                last = seal.record(line)
                if last is not None:
                    self._n, self._hash = last.n, last.hash
                    self._first = self._first_of_current()
                    return

    def _first_of_current(self) -> int:
        """The number of its first record; the next one where it is empty."""
        try:
            with self.places.current.open("rb") as file:
                found = seal.record(file.readline().rstrip(b"\n"))
        except FileNotFoundError:
            found = None
        return found.n if found else self._n + 1

    # --- writing ---------------------------------------------------------------------------------------------------

    def append(self, bodies: Sequence[Json]) -> list[int]:
        """Their numbers; durable when it returns. Raises OSError, and then none of them is there."""
        n, hash, lines = self._n, self._hash, []
        for body in bodies:
            n += 1
            line, hash = seal.record_line(n, hash, self._number, body)
            lines.append(line)
        self._journal.append(b"".join(lines))
        first, self._n, self._hash, self._new = self._n + 1, n, hash, True
        if self._journal.size >= self._full_at:
            self._put_away()
        return list(range(first, n + 1))

    def _put_away(self) -> None:
        """The file is full. Where that fails it grows on: its records are kept either way."""
        full = self.places.full(self._first)
        if full.exists():
            return
        with suppress(OSError):
            self._journal.close()
            self.places.current.rename(full)
            self._first = self._n + 1
            sync_folder(self.places.folder)

    def mark(self) -> None:
        """Write a checkpoint, unless nothing happened since the last one. Raises OSError."""
        if not self._opened or not self._new:
            return
        last = (self._n, self._hash)
        line, mac = seal.checkpoint_line(self._number + 1, last, self._mac, self._now_ms(), self._key)
        self._marks.append(line)
        self._number, self._mac, self._new = self._number + 1, mac, False

    def close(self) -> None:
        """Idempotent."""
        self._opened = False
        self._journal.close()
        self._marks.close()
