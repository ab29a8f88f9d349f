"""Power loss: flushed samples survive, whatever part of the unsynced writes reaches the disk.

A preloaded library records every write and sync. From its log come the files as a disk may hold them after a cut at any
moment: all synced bytes, and of the others a random part in sectors of 512 bytes. ``DRIVEBUS_CUTS=1000`` makes the long
run.
"""

from __future__ import annotations

import os
import random
import sqlite3
import struct
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from drivebus.service.config.model import HistoryConfig
from drivebus.service.historian import Historian
from fixtures.historian import NOON_MS, good_values, samples_of
from peers import need_program

CUTS = int(os.environ.get("DRIVEBUS_CUTS", "20"))
HERE = Path(__file__).parent
SECTOR = 512
BATCHES = 60

PROGRAM = f"""
import asyncio, os, sys
from pathlib import Path
from drivebus.service.historian import Historian, writer
from drivebus.service.config.model import HistoryConfig
from drivebus.service.live.views import Sample
from drivebus.values import Quality

async def main():
    writer.MAX_OPEN_SAMPLES, writer.MAX_OPEN_SAMPLES_PER_TAG = 200, 0
    acknowledgements = os.open(sys.argv[1] + "/history.acknowledged", os.O_WRONLY | os.O_CREAT)
    async with Historian(HistoryConfig(), Path(sys.argv[1]), flush_s=1e6) as historian:
        for n in range({BATCHES}):
            for t in range(10 * n, 10 * n + 10):
                historian.append([Sample(f"a.b{{tag}}", {NOON_MS} + t, float(t), Quality.GOOD) for tag in range(4)])
            await historian.flush()
            os.write(acknowledgements, b"x")
            await historian._on_writer_thread(historian.writer.run_cycle)

asyncio.run(main())
"""


@dataclass
class Disk:
    """Simulated file: its synced bytes, and the writes since."""

    synced: bytearray = field(default_factory=bytearray)
    since: list[tuple[str, int, bytes | int]] = field(default_factory=list)

    def sync(self) -> None:
        for kind, offset, what in self.since:
            _apply(self.synced, kind, offset, what)
        self.since = []

    def cut(self, chance: random.Random) -> bytes:
        """Return the content after a power cut now."""
        found, share = bytearray(self.synced), chance.choice([0.0, 0.1, 0.5, 0.9, 1.0])
        for kind, offset, what in self.since:
            if isinstance(what, int):
                if chance.random() < share:
                    _apply(found, kind, offset, what)
                continue
            for at in range(0, len(what), SECTOR):
                if chance.random() < share:
                    _apply(found, kind, offset + at, what[at : at + SECTOR])
        return bytes(found)


def _apply(content: bytearray, kind: str, offset: int, what: bytes | int) -> None:
    if isinstance(what, int):
        del content[what:]
        content.extend(bytes(what - len(content)))
    else:
        content.extend(bytes(max(0, offset - len(content))))
        content[offset : offset + len(what)] = what


def records(log: bytes) -> Iterator[tuple[str, int, int, bytes | int]]:
    """Yield kind, file, offset, and the bytes (W, N) or the size (T, S)."""
    at = 0
    while at < len(log):
        mixed, offset, size = struct.unpack_from("<QQQ", log, at)
        kind, at = chr(mixed >> 32), at + 24
        data: bytes | int = log[at : at + size] if kind in "WN" else size
        at += size if kind in "WN" else 0
        yield kind, mixed & 0xFFFFFFFF, offset, data


def images(log: bytes, chance: random.Random, count: int) -> Iterator[tuple[dict[str, bytes], int]]:
    """Yield the files after cuts at random moments, and the number of batches acknowledged by then."""
    known = list(records(log))
    moments = sorted(chance.choices(range(1, len(known) + 1), k=count))
    names: dict[int, str] = {}
    disks: dict[int, Disk] = {}
    acknowledged = done = 0
    for moment in moments:
        for kind, file, offset, what in known[done:moment]:
            if kind == "N":
                assert isinstance(what, bytes)
                names[file], disks[file] = Path(what.decode()).name, Disk()
            elif names[file] == "history.acknowledged":
                acknowledged += 1
            elif kind == "S":
                disks[file].sync()
            else:
                disks[file].since.append((kind, offset, what))
        done = moment
        yield {name: disks[n].cut(chance) for n, name in names.items() if name != "history.acknowledged"}, acknowledged


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Log of the system calls of a writer."""
    folder = tmp_path_factory.mktemp("power")
    library = folder / "synclog.so"
    gcc = need_program("gcc", "gcc")
    subprocess.run([gcc, "-O1", "-shared", "-fPIC", "-o", library, HERE / "synclog.c", "-ldl"], check=True)
    (folder / "plant").mkdir()
    preload = {
        "LD_PRELOAD": str(library),
        "SYNCLOG": str(folder / "log"),
        "SYNCLOG_MATCH": str(folder / "plant/history."),
    }
    command = [sys.executable, "-c", PROGRAM, folder / "plant"]
    subprocess.run(command, env={**os.environ, **preload}, check=True)
    return (folder / "log").read_bytes()


async def test_flushed_samples_survive_a_power_cut_at_any_moment(log: bytes, tmp_path: Path) -> None:
    chance = random.Random(11)
    unsynced = 0
    for n, (files, acknowledged) in enumerate(images(log, chance, CUTS)):
        folder = tmp_path / str(n)
        folder.mkdir()
        for name, content in files.items():
            (folder / name).write_bytes(content)
        async with Historian(HistoryConfig(), folder) as historian:
            assert historian.ok, historian.status()
            for tag in historian.queries.tags()["tags"]:
                found = await samples_of(historian, tag["tag"], 0, 2**60)
                assert found.number == list(range(len(found.number)))
                values = good_values(found.samples[1])
                assert values == [float(number) for number in range(len(values))]
                assert len(values) >= 10 * acknowledged
                assert len(found.number) - len(values) <= 1  # the gap of this start
            assert acknowledged == 0 or len(historian.queries.tags()["tags"]) == 4
        database = sqlite3.connect(folder / "history.db")
        assert database.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        database.close()
        unsynced += acknowledged < BATCHES
    assert unsynced > CUTS // 2


def test_the_log_has_every_file_and_every_sync(log: bytes) -> None:
    """Otherwise the test above could not fail."""
    known = list(records(log))
    names = {Path(what.decode()).name for kind, _, _, what in known if kind == "N" and isinstance(what, bytes)}
    assert {"history.db", "history.db-wal", "history.acknowledged"} <= names
    assert [kind for kind, *_ in known].count("S") > BATCHES
