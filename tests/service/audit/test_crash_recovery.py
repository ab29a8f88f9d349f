"""Crash recovery: after a kill or power cut at any point, acknowledged records exist and the chain is valid."""

from __future__ import annotations

import os
import random
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from drivebus.service.audit import records
from drivebus.service.audit.chain import AuditChain, AuditPaths
from drivebus.service.audit.records import entry_json
from drivebus.service.audit.verify import verify
from fixtures.audit import sample_entry

MAX_FILE_BYTES = 3_000


class Killed(BaseException):
    """Death of the process: nothing catches it."""


class FailingPower:
    """Disk whose power fails at the ``nth`` call; bytes that were not synced are then cut or lost in part."""

    def __init__(self, nth: int, *, cut: bool) -> None:
        self.nth, self.cut, self.calls = nth, cut, 0
        self._synced: dict[int, int] = {}
        self._rng = random.Random(nth)

    @contextmanager
    def failing(self, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
        real_write, real_rename, real_cut = os.write, os.rename, os.ftruncate

        def write(fd: int, data: bytes) -> int:
            if self._now():
                real_write(fd, data[: self._rng.randrange(len(data) + 1)])
                raise Killed
            return real_write(fd, data)

        def sync(fd: int) -> None:
            if self._now():
                raise Killed
            found = os.fstat(fd)
            self._synced[found.st_ino] = found.st_size

        def rename(*names: Any, **more: Any) -> None:
            if self._now():
                raise Killed
            real_rename(*names, **more)

        def truncate(fd: int, size: int) -> None:
            if self._now():
                raise Killed
            real_cut(fd, size)

        with monkeypatch.context() as context:
            for name, function in (("write", write), ("fsync", sync), ("rename", rename), ("ftruncate", truncate)):
                context.setattr(os, name, function)
            yield

    def _now(self) -> bool:
        self.calls += 1
        return self.calls == self.nth

    def lose(self, folder: Path) -> None:
        """Drop bytes that were not synced."""
        for path in (*folder.glob("audit*.jsonl"), *folder.glob("checkpoints.jsonl")):
            data, safe = path.read_bytes(), self._synced.get(path.stat().st_ino, 0)
            loose = bytearray(data[safe:])
            if not loose or not self.cut:
                continue
            hole = self._rng.randrange(len(loose))
            loose[hole : hole + 40] = b"\0" * len(loose[hole : hole + 40])
            path.write_bytes(data[:safe] + bytes(loose[: self._rng.randrange(len(loose) + 1)]))


def write_records(paths: AuditPaths, acknowledged: list[int], start: int) -> None:
    chain = AuditChain(paths, lambda: 1_795_219_200_000, MAX_FILE_BYTES)
    try:
        chain.open()
        for n in range(start, start + 12):
            acknowledged += chain.append([entry_json(sample_entry(n), n), entry_json(sample_entry(n), n)])
            if n % 4 == 3:
                chain.write_checkpoint()
        chain.write_checkpoint()
    except Killed:
        for log in (chain._records, chain._checkpoints):
            if log._fd >= 0:
                os.close(log._fd)
        raise
    chain.close()


@pytest.mark.parametrize("cut", [False, True], ids=["killed", "power cut"])
def test_no_acknowledged_record_is_lost_whatever_call_is_the_last(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cut: bool
) -> None:
    clean = False
    nth = 0
    while not clean:
        nth += 1
        paths = AuditPaths.of(tmp_path / str(nth) / "plant")
        acknowledged: list[int] = []
        power = FailingPower(nth, cut=cut)
        with power.failing(monkeypatch):
            try:
                write_records(paths, acknowledged, 0)
                clean = True
            except Killed:
                pass
        power.lose(paths.folder)
        write_records(paths, acknowledged, 100)
        report = verify(paths)
        assert report.ok, (nth, report.problems)
        recorded = {
            found.n for path in paths.files() for line in path.open("rb") if (found := records.decode_record(line[:-1]))
        }
        assert set(acknowledged) <= recorded, nth
    assert nth > 40


ZYGOTE = """
import asyncio, os, sys
from pathlib import Path
from drivebus.service.audit import AuditEntry, AuditTrail

async def run(folder):
    trail = AuditTrail(Path(folder), max_file_bytes=20_000)
    await trail.open()
    async def write(name):
        while True:
            text = f"{name} {os.getpid()} {os.urandom(4).hex()}"
            number = await trail.record(AuditEntry(what="drive.run", target=text))
            os.write(1, f"{number} {text}\\n".encode())
    async def checkpoint():
        while True:
            await asyncio.sleep(0.01)
            await trail.checkpoint()
    await asyncio.gather(write("a"), write("b"), write("c"), checkpoint())

for folder in sys.stdin:
    pid = os.fork()
    if pid == 0:
        asyncio.run(run(folder.strip()))
    os.write(1, f"pid {pid}\\n".encode())
    os.waitpid(pid, 0)
    os.write(1, b"end\\n")
"""


def test_kill_9_at_twenty_random_points_loses_no_acknowledged_record(tmp_path: Path) -> None:
    paths = AuditPaths.of(tmp_path / "plant")
    rng = random.Random(10)
    acknowledged: dict[int, str] = {}
    child = subprocess.Popen(
        [sys.executable, "-u", "-c", ZYGOTE], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
    )
    assert child.stdin is not None and child.stdout is not None
    try:
        for _ in range(20):
            child.stdin.write(f"{paths.folder}\n")
            pid, wanted = 0, rng.randint(1, 60)
            for line in child.stdout:
                word, _, rest = line.strip().partition(" ")
                if word == "end":
                    break
                if word == "pid":
                    pid = int(rest)
                    continue
                acknowledged[int(word)] = rest
                wanted -= 1
                if wanted <= 0 and pid:
                    os.kill(pid, 9)
                    wanted = 10**9
    finally:
        child.kill()
        child.communicate()
    chain = AuditChain(paths, lambda: 1)
    found = chain.open()
    chain.append([entry_json(entry, 1) for entry in found])
    chain.close()
    assert verify(paths).ok, verify(paths).problems
    recorded = {
        record.n: record.body["target"]
        for path in paths.files()
        for line in path.open("rb")
        if (record := records.decode_record(line[:-1]))
    }
    assert len(acknowledged) > 100
    assert {n: recorded.get(n) for n in acknowledged} == acknowledged
