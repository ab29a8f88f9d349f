"""A drivebus command as a child process, with or without a terminal of its own."""

from __future__ import annotations

import os
import select
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

COMMAND = [sys.executable, "-c", "from drivebus.cli import main; main()"]
PATIENCE_S = 20.0
"""A loaded machine may be slow; nothing is asserted about how long it takes."""

ENVIRONMENT = {name: value for name, value in os.environ.items() if name not in ("LC_ALL", "LANG")} | {
    "DRIVEBUS_LANG": "en",
    "PYTHONUNBUFFERED": "1",
    "NO_COLOR": "1",
    "TERM": "xterm",
}


@contextmanager
def child(*words: str) -> Iterator[subprocess.Popen[str]]:
    """A running command whose output is piped."""
    process = subprocess.Popen(
        [*COMMAND, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=ENVIRONMENT
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def lines_until(process: subprocess.Popen[str], wanted: Callable[[str], bool]) -> list[str]:
    """Lines of output up to the first one that is wanted."""
    assert process.stdout is not None
    found: list[str] = []
    for line in process.stdout:
        found.append(line)
        if wanted(line):
            return found
    raise AssertionError(f"ended without it: {found} {process.stderr and process.stderr.read()}")


class Terminal:
    """A command on a pseudo-terminal of its own, as a person would run it."""

    def __init__(self, *words: str) -> None:
        import pty

        self.pid, self.fd = pty.fork()
        if self.pid == 0:
            os.execve(sys.executable, [*COMMAND, *words], ENVIRONMENT)
        self.seen = ""

    def wait_for(self, text: str, meanwhile: Callable[[], None] = lambda: None) -> None:
        """Read until ``text`` appeared; ``meanwhile`` is done again and again (a held key)."""
        deadline = time.monotonic() + PATIENCE_S
        while text not in self.seen:
            assert time.monotonic() < deadline, f"{text!r} never came: {self.seen[-2000:]!r}"
            meanwhile()
            try:
                self.read()
            except OSError:
                raise AssertionError(f"{text!r} never came: {self.seen[-2000:]!r}") from None

    def read(self) -> None:
        """Take in what the command wrote, if anything comes within a moment. Raises OSError where it has ended."""
        if select.select([self.fd], [], [], 0.05)[0]:
            self.seen += os.read(self.fd, 4096).decode(errors="replace")

    def press(self, keys: str) -> None:
        os.write(self.fd, keys.encode())

    def hang_up(self) -> None:
        """The terminal goes away: its window is closed, its cable is cut."""
        os.close(self.fd)
        self.fd = -1

    def exit_code(self) -> int:
        """Wait for the end."""
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self.pid = 0
                return os.waitstatus_to_exitcode(status)
            if self.fd >= 0:
                with suppress(OSError):
                    self.read()
            else:
                time.sleep(0.05)
        raise AssertionError(f"never ended: {self.seen[-2000:]!r}")

    def __enter__(self) -> Terminal:
        return self

    def __exit__(self, *exc: object) -> None:
        if self.pid:
            with suppress(ProcessLookupError):
                os.kill(self.pid, 9)
            os.waitpid(self.pid, 0)
        if self.fd >= 0:
            os.close(self.fd)
