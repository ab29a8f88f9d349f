"""Output of an attached command, written by threads of their own.

A pager, Ctrl-S or a connection that hangs lets a write wait without end; in the event loop it would keep Ctrl-C from
stopping the motor.
"""

from __future__ import annotations

import os
import sys
import threading
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from typing import TextIO

from drivebus.atomic_write import write_all
from drivebus.errors import SystemReason

WRITE_TIMEOUT_S = 0.1  # a stream whose write takes longer is blocked: its reader does not read


class BackgroundStream:
    """Writer of a stream in a thread; a text that waits keeps its place before the later ones."""

    def __init__(self, stream: TextIO) -> None:
        """``stream``: with a descriptor, to which it writes. Raises OSError without one."""
        stream.flush()
        self._descriptor, self._encoding = stream.fileno(), stream.encoding
        self._errors = "backslashreplace" if stream.errors in (None, "strict") else stream.errors
        self._changed = threading.Condition()
        self._queue: deque[bytes] = deque()  # the first one is being written
        self._error: OSError | None = None  # of a write, until it is raised
        self._is_closed = False
        threading.Thread(target=self._write_queue, daemon=True).start()

    @property
    def is_blocked(self) -> bool:
        """Whether texts wait for the reader."""
        return bool(self._queue)

    def write(self, text: str) -> None:
        """Write a text, or queue it where the stream is blocked. Raises the OSError of this or of an earlier write."""
        with self._changed:
            was_blocked = self.is_blocked
            self._queue.append(text.encode(self._encoding, self._errors))
            self._changed.notify_all()
            if not was_blocked:
                self._changed.wait_for(lambda: not self._queue, WRITE_TIMEOUT_S)
            error, self._error = self._error, None
        if error is not None:
            raise error

    def close(self) -> OSError | None:
        """Wait until everything is written or the stream has failed; Ctrl-C gives the rest up.

        Return the error of a write that ``write`` has not raised.
        """
        with self._changed, suppress(KeyboardInterrupt):
            self._changed.wait_for(lambda: not self._queue)
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()
            return self._error

    def _write_queue(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._queue or self._is_closed)
                if self._is_closed:
                    return
                data = self._queue[0]
            error: OSError | None = None
            try:
                write_all(self._descriptor, data)
            except OSError as failure:
                error = failure
            with self._changed:
                self._queue.popleft()
                if error is not None:
                    self._error = error
                    self._queue.clear()
                self._changed.notify_all()


_streams: ContextVar[Mapping[TextIO, BackgroundStream]] = ContextVar("drivebus_background_streams")


@contextmanager
def background_output() -> Iterator[None]:
    """Write standard output and standard error in the background; wait for the reader at the end only.

    Where both lead to one pipe, file or terminal they share one queue, else each has its own order. What can't be
    written to standard output is reported on standard error.
    """
    from drivebus.cli import output

    streams: dict[TextIO, BackgroundStream] = {}
    with suppress(OSError, ValueError):  # a stream of a test has no descriptor
        streams[sys.stdout] = BackgroundStream(sys.stdout)
    with suppress(OSError, ValueError):
        is_shared = sys.stdout in streams and _have_one_target(sys.stdout, sys.stderr)
        streams[sys.stderr] = streams[sys.stdout] if is_shared else BackgroundStream(sys.stderr)
    before = _streams.set(streams)
    try:
        yield
    finally:
        _streams.reset(before)
        for stream, background in streams.items():
            error = background.close()
            if error is not None and stream is sys.stdout:
                output.print_note("cli.output_lost", reason=SystemReason(error))


def _have_one_target(first: TextIO, other: TextIO) -> bool:
    """Return whether two streams lead to the same pipe, file or terminal. Raises OSError without a descriptor."""
    targets = [os.fstat(stream.fileno()) for stream in (first, other)]
    has_identity = targets[0].st_ino != 0  # a pipe of Windows has none
    return has_identity and os.path.samestat(*targets)


def background_stream(stream: TextIO) -> BackgroundStream | None:
    """Return the writer of a stream; None outside of ``background_output``, where it is written at once."""
    return _streams.get({}).get(stream)
