"""Append-only file and batch writer on a disk that fails."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Sequence
from pathlib import Path

import pytest

from drivebus.atomic_write import atomic_write_private
from drivebus.service.storage.append_log import AppendLog, read_tail
from drivebus.service.storage.batch_writer import BatchWriter


def failing_after(size: int) -> object:
    """Return an ``os.write`` that writes this many bytes and then reports a full disk."""
    real = os.write

    def write(fd: int, data: bytes) -> int:
        nonlocal size
        if size <= 0:
            raise OSError(28, "No space left on device")
        taken = real(fd, data[:size])
        size -= taken
        return taken

    return write


def test_a_disk_that_takes_a_little_at_a_time_gets_everything(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = os.write
    monkeypatch.setattr(os, "write", lambda fd, data: real(fd, data[:3]))
    log = AppendLog(tmp_path / "x")
    log.append(b"0123456789\n")
    atomic_write_private(tmp_path / "y", b"0123456789\n")
    assert (tmp_path / "x").read_bytes() == (tmp_path / "y").read_bytes() == b"0123456789\n"
    assert log.size == 11


def test_a_disk_that_takes_nothing_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "write", lambda fd, data: 0)
    with pytest.raises(OSError, match="No space left"):
        AppendLog(tmp_path / "x").append(b"a\n")


def test_the_bytes_of_a_failed_write_are_cut_off_before_the_next_one_and_at_close(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = AppendLog(tmp_path / "x")
    log.append(b"one\n")
    with monkeypatch.context() as context:
        context.setattr(os, "write", failing_after(2))
        with pytest.raises(OSError):
            log.append(b"two\n")
    assert (tmp_path / "x").read_bytes() == b"one\ntw"
    log.append(b"three\n")
    assert (tmp_path / "x").read_bytes() == b"one\nthree\n"
    with monkeypatch.context() as context:
        context.setattr(os, "write", failing_after(2))
        with pytest.raises(OSError):
            log.append(b"four\n")
    log.close()
    log.close()
    assert (tmp_path / "x").read_bytes() == b"one\nthree\n"


def test_a_record_is_synced_and_a_failed_sync_leaves_none_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[int] = []
    monkeypatch.setattr(os, "fsync", lambda fd: synced.append(os.fstat(fd).st_size))
    log = AppendLog(tmp_path / "x")
    log.append(b"one\n")
    assert synced[-1] == 4

    def broken(fd: int) -> None:
        raise OSError(5, "Input/output error")

    with monkeypatch.context() as context:
        context.setattr(os, "fsync", broken)
        with pytest.raises(OSError):
            log.append(b"two\n")
    log.append(b"three\n")
    assert (tmp_path / "x").read_bytes() == b"one\nthree\n"
    assert synced[-1] == 10


def test_a_link_of_another_user_is_not_followed_and_a_fifo_blocks_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a folder that others can write, records were appended to the file that their link names, and their FIFO kept
    the service from starting.
    """
    target, path = tmp_path / "target", tmp_path / "log"
    target.write_bytes(b"content\n")
    path.symlink_to(target)
    log = AppendLog(path)
    log.append(b"own link\n")
    assert read_tail(path) == target.read_bytes() == b"content\nown link\n"
    log.close()
    if os.geteuid() == 0:
        os.chown(path, 65534, 65534, follow_symlinks=False)
    else:
        monkeypatch.setattr(os, "geteuid", lambda: 65534)
    for action in (lambda: log.append(b"foreign link\n"), lambda: read_tail(path)):
        with pytest.raises(PermissionError):
            action()
    assert target.read_bytes() == b"content\nown link\n"
    path.unlink()
    os.mkfifo(path)
    for action in (lambda: log.append(b"fifo\n"), lambda: read_tail(path)):
        with pytest.raises(OSError, match="Invalid argument"):
            action()


def test_a_log_that_is_replaced_by_a_link_of_another_user_while_it_is_open_is_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target, path = tmp_path / "target", tmp_path / "log"
    target.write_bytes(b"content\n")
    log = AppendLog(path)
    log.append(b"first\n")
    path.unlink()
    path.symlink_to(target)
    if os.geteuid() == 0:
        os.chown(path, 65534, 65534, follow_symlinks=False)
    else:
        monkeypatch.setattr(os, "geteuid", lambda: 65534)
    with pytest.raises(PermissionError):
        log.append(b"second\n")
    assert target.read_bytes() == b"content\n"


async def test_an_item_queued_while_a_batch_fails_is_tried_at_once() -> None:
    """The disk may work again by then."""
    batches: list[list[str]] = []
    started, go_on = asyncio.Event(), asyncio.Event()
    loop = asyncio.get_running_loop()

    def write_batch(batch: Sequence[str]) -> Sequence[str]:
        batches.append(list(batch))
        if len(batches) == 1:
            loop.call_soon_threadsafe(started.set)
            asyncio.run_coroutine_threadsafe(go_on.wait(), loop).result()
            raise OSError(28, "No space left on device")
        return [item.upper() for item in batch]

    writer: BatchWriter[str, str] = BatchWriter("test", write_batch)
    first = asyncio.ensure_future(writer.write("a"))
    writer.write_nowait("b")
    await started.wait()
    second = asyncio.ensure_future(writer.write("c"))
    await asyncio.sleep(0)
    go_on.set()
    with pytest.raises(OSError):
        await first
    assert await second == "C"
    assert batches == [["b", "a"], ["b", "c"]]
    assert writer.error is None
    await writer.close()
