"""``CommLossReads``: reads of the drives' behaviour at communication loss, beside the supervision cycle."""

from __future__ import annotations

import asyncio

from drivebus.errors import DrivebusError
from drivebus.service.runtime.drive import DriveRuntime
from drivebus.service.runtime.plant import Plant

COMM_LOSS_READ_INTERVAL_S = 3600.0  # between two reads: each costs bus time
COMM_LOSS_RETRY_S = 60.0  # of a drive that was never read: the last read failed
COMM_LOSS_REREAD_S = 2.0  # where a parameter was written since


class CommLossReads:
    """Reads under way: of each drive once it is online, after writes of parameters, and each hour."""

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self._tasks: set[asyncio.Task[None]] = set()

    def schedule(self, runtime: DriveRuntime) -> None:
        """Start the read of a drive where it is due."""
        if not runtime.is_online or runtime.monitor is None:
            return
        comm_loss, now = runtime.comm_loss, self._plant.now()
        wait_s = COMM_LOSS_READ_INTERVAL_S if comm_loss.read_at is not None else COMM_LOSS_RETRY_S
        wait_s = COMM_LOSS_REREAD_S if comm_loss.is_stale else wait_s
        if comm_loss.requested_at is not None and now - comm_loss.requested_at < wait_s:
            return
        comm_loss.requested_at = now
        task = asyncio.create_task(self._read(runtime), name=f"communication loss {runtime.id}")
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _read(self, runtime: DriveRuntime) -> None:
        writes_before = runtime.comm_loss.write_count
        try:
            report = await runtime.drive.comm_loss_behaviour()
        except (DrivebusError, KeyError):
            return
        runtime.comm_loss.set_read(report, runtime.profile.comm_loss, self._plant.now(), writes_before)

    async def close(self) -> None:
        """Cancel the reads that are under way."""
        tasks = tuple(self._tasks)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
