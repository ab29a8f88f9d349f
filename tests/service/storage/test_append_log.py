"""An append-only file on a disk that does as disks do; and what many tasks hand to one thread."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Sequence
from pathlib import Path

import pytest

from drivebus.atomic_write import atomic_write_private
from drivebus.service.storage.append_log import AppendLog
from drivebus.service.storage.batch_writer import BatchWriter


def failing_after(octets: int) -> object:
    """``os.write`` that takes so many octets and then has no room."""
    real = os.write

    def write(fd: int, data: bytes) -> int:
        nonlocal octets
        if octets <= 0:
            raise OSError(28, "No space left on device")
        taken = real(fd, data[:octets])
        octets -= taken
        return taken

    return write


def test_a_disk_that_takes_a_little_at_a_time_gets_everything(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = os.write
    monkeypatch.setattr(os, "write", lambda fd, data: real(fd, data[:3]))
    journal = AppendLog(tmp_path / "x")
    journal.append(b"0123456789\n")
    atomic_write_private(tmp_path / "y", b"0123456789\n")
    assert (tmp_path / "x").read_bytes() == (tmp_path / "y").read_bytes() == b"0123456789\n"
    assert journal.size == 11


def test_a_disk_that_takes_nothing_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "write", lambda fd, data: 0)
    with pytest.raises(OSError, match="No space left"):
        AppendLog(tmp_path / "x").append(b"a\n")


def test_what_was_refused_is_gone_before_the_next_is_written_and_when_the_file_is_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    journal = AppendLog(tmp_path / "x")
    journal.append(b"one\n")
    with monkeypatch.context() as context:
        context.setattr(os, "write", failing_after(2))
        with pytest.raises(OSError):
            journal.append(b"two\n")
    assert (tmp_path / "x").read_bytes() == b"one\ntw"
    journal.append(b"three\n")
    assert (tmp_path / "x").read_bytes() == b"one\nthree\n"
    with monkeypatch.context() as context:
        context.setattr(os, "write", failing_after(2))
        with pytest.raises(OSError):
            journal.append(b"four\n")
    journal.close()
    journal.close()
    assert (tmp_path / "x").read_bytes() == b"one\nthree\n"


def test_it_is_synced_before_it_is_kept_and_a_sync_that_fails_keeps_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[int] = []
    monkeypatch.setattr(os, "fsync", lambda fd: synced.append(os.fstat(fd).st_size))
    journal = AppendLog(tmp_path / "x")
    journal.append(b"one\n")
    assert synced[-1] == 4

    def broken(fd: int) -> None:
        raise OSError(5, "Input/output error")

    with monkeypatch.context() as context:
        context.setattr(os, "fsync", broken)
        with pytest.raises(OSError):
            journal.append(b"two\n")
    journal.append(b"three\n")
    assert (tmp_path / "x").read_bytes() == b"one\nthree\n"
    assert synced[-1] == 10


async def test_who_comes_while_a_batch_fails_has_a_try_of_his_own() -> None:
    """A disk that works again by then serves him; nobody waits for a timer."""
    tries: list[list[str]] = []
    begun, go_on = asyncio.Event(), asyncio.Event()
    loop = asyncio.get_running_loop()

    def keep(batch: Sequence[str]) -> Sequence[str]:
        tries.append(list(batch))
        if len(tries) == 1:
            loop.call_soon_threadsafe(begun.set)
            asyncio.run_coroutine_threadsafe(go_on.wait(), loop).result()
            raise OSError(28, "No space left on device")
        return [item.upper() for item in batch]

    grouped: BatchWriter[str, str] = BatchWriter("test", keep)
    first = asyncio.ensure_future(grouped.write("a"))
    grouped.write_nowait("b")
    await begun.wait()
    second = asyncio.ensure_future(grouped.write("c"))
    await asyncio.sleep(0)
    go_on.set()
    with pytest.raises(OSError):
        await first
    assert await second == "C"
    assert tries == [["b", "a"], ["b", "c"]]
    assert grouped.error is None
    await grouped.close()
