"""Child process of the service: restarted with growing pauses when it exits, and ended with the service."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable, Sequence

FIRST_RESTART_PAUSE_S, MAX_RESTART_PAUSE_S = 0.5, 30.0  # doubling in between
STEADY_RUN_S = 60.0  # after a run of this length the next pause is the first one again
TERMINATE_TIMEOUT_S = 2.0  # before it is killed
LOG = logging.getLogger("drivebus.service")


class ChildProcess:
    """One child process. Its output is the plant's own."""

    def __init__(self, command: Sequence[str], now: Callable[[], float], on_exit: Callable[[int], None]) -> None:
        """``on_exit`` is called with the exit code when it exits by itself."""
        self._command, self._now, self._on_exit = tuple(command), now, on_exit
        self._task: asyncio.Task[None] | None = None
        self.process: asyncio.subprocess.Process | None = None
        self.starts = 0

    def start(self) -> None:
        self._task = asyncio.create_task(self._run(), name="web process")

    async def _run(self) -> None:
        pause_s = FIRST_RESTART_PAUSE_S
        while True:
            begun = self._now()
            code = await self._run_once()
            self._on_exit(code)
            pause_s = FIRST_RESTART_PAUSE_S if self._now() - begun >= STEADY_RUN_S else pause_s
            await asyncio.sleep(pause_s)
            pause_s = min(MAX_RESTART_PAUSE_S, 2 * pause_s)

    async def _run_once(self) -> int:
        """Run it once and return its exit code, 127 where it can't be started.

        A process group of its own keeps a terminal's Ctrl-C from it; the service ends it. It gets no session of its
        own: Linux would give that as much processor time as the service.
        """
        try:
            self.process = await asyncio.create_subprocess_exec(
                *self._command, stdin=asyncio.subprocess.DEVNULL, process_group=0
            )
        except OSError as error:
            LOG.error("the web process can't be started: %s", error)
            return 127
        self.starts += 1
        return await self.process.wait()

    async def close(self) -> None:
        """End it, by force where it takes too long."""
        if self._task is not None:
            self._task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._task
        process = self.process
        if process is None or process.returncode is not None:
            return
        process.terminate()
        try:
            await asyncio.wait_for(process.wait(), TERMINATE_TIMEOUT_S)
        except TimeoutError:
            process.kill()
            await process.wait()
