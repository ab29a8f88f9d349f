"""Keys of the terminal as they are pressed. The only module that changes the mode of the terminal."""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

MAX_TERMINAL_INPUT = 4096  # bytes that a terminal keeps: all that waited are read at once, and so known to be old


class KeyQueue:
    """Queue of pressed keys; ``None`` means that the terminal is gone."""

    def __init__(self) -> None:
        self._queue: asyncio.Queue[str | None] = asyncio.Queue()
        self.last_key: str | None = None
        self.last_key_at = float("-inf")

    def on_keys(self, text: str | None) -> None:
        """Add keys; called from the event loop."""
        self.last_key_at = asyncio.get_running_loop().time()
        for key in text or ():
            self.last_key = key
            self._queue.put_nowait(key)
        if text is None:
            self.last_key = None
            self._queue.put_nowait(None)

    async def get(self, timeout_s: float | None = None) -> str | None:
        """Return the next key. Raises TimeoutError after ``timeout_s`` seconds."""
        return await asyncio.wait_for(self._queue.get(), timeout_s)

    def clear(self) -> None:
        """Drop the queued keys."""
        while not self._queue.empty():
            self._queue.get_nowait()


@contextmanager
def raw_keyboard() -> Iterator[KeyQueue]:
    """Read keys of the terminal unbuffered and without echo; restore its former mode at the end."""
    keys = KeyQueue()
    with _read_windows(keys) if sys.platform == "win32" else _read_posix(keys):
        yield keys


@contextmanager
def _read_posix(keys: KeyQueue) -> Iterator[None]:
    import termios
    import tty

    loop, fd = asyncio.get_running_loop(), sys.stdin.fileno()
    former = termios.tcgetattr(fd)

    def ready() -> None:
        try:
            data = os.read(fd, MAX_TERMINAL_INPUT)
        except OSError:
            data = b""
        if not data:
            loop.remove_reader(fd)
        keys.on_keys(data.decode(errors="replace") if data else None)

    tty.setcbreak(fd)
    loop.add_reader(fd, ready)
    try:
        yield
    finally:
        loop.remove_reader(fd)
        try:
            termios.tcsetattr(fd, termios.TCSADRAIN, former)
        except termios.error:
            return  # the terminal is gone, and its mode with it


@contextmanager
def _read_windows(keys: KeyQueue) -> Iterator[None]:
    import msvcrt  # the only keyboard that Windows consoles have
    import threading

    loop, over = asyncio.get_running_loop(), threading.Event()

    def watch() -> None:
        while not over.wait(0.01):
            while msvcrt.kbhit():  # type: ignore[attr-defined,unused-ignore]
                loop.call_soon_threadsafe(keys.on_keys, msvcrt.getwch())  # type: ignore[attr-defined,unused-ignore]

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
