"""A real PostgreSQL server for tests: Debian's programs, a directory of its own, a socket nobody else can reach."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import quote

from peers import missing, need_module


def _programs() -> Path:
    """The newest version's folder."""
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"), key=lambda path: float(path.parts[-3]))
    if not found:
        missing("postgresql", "apt-get install postgresql")
    return found[-1].parent


class Server:
    """A running server; ``stop`` and ``start`` as often as a test wants."""

    def __init__(self, folder: Path) -> None:
        self._programs, self._folder = _programs(), folder
        # The server refuses to run as root; Debian's package made a user for it.
        self._user = "postgres" if os.geteuid() == 0 else None
        if self._user:
            shutil.chown(folder, self._user)
        self._run("initdb", "-D", str(folder / "data"), "-A", "trust", "-U", "drivebus", "--no-sync", "-E", "UTF8")

    def _run(self, program: str, *arguments: str) -> None:
        subprocess.run(
            [self._programs / program, *arguments], user=self._user, cwd=self._folder, check=True,
            stdout=subprocess.DEVNULL, env={"PATH": os.environ["PATH"], "LC_ALL": "C.UTF-8"},
        )  # fmt: skip

    def url(self, database: str) -> str:
        return f"postgresql://drivebus@/{database}?host={quote(str(self._folder))}"

    def start(self) -> None:
        options = f"-k {self._folder} -c listen_addresses='' -c fsync=off -c max_connections=40 -c shared_buffers=64MB"
        log = str(self._folder / "log")
        self._run("pg_ctl", "start", "-w", "-s", "-D", str(self._folder / "data"), "-l", log, "-o", options)

    def stop(self, how: str = "fast") -> None:
        self._run("pg_ctl", "stop", "-w", "-s", "-m", how, "-D", str(self._folder / "data"))

    def create(self, database: str) -> None:
        self._run(
            "psql", "-q", "-h", str(self._folder), "-U", "drivebus", "postgres", "-c", f"CREATE DATABASE {database}"
        )


@contextmanager
def server() -> Iterator[Server]:
    """Skips by name where the programs or asyncpg are missing."""
    need_module("asyncpg")
    # Not under the test's own folder: its path may be too long for a socket, or closed to the server's user.
    with tempfile.TemporaryDirectory(prefix="drivebus-pg-") as name:
        found = Server(Path(name))
        found.start()
        try:
            yield found
        finally:
            found.stop("immediate")
            deadline = time.monotonic() + 5
            while (Path(name) / "data" / "postmaster.pid").exists() and time.monotonic() < deadline:
                time.sleep(0.02)


__all__ = ["Server", "server"]
