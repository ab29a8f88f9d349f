"""Demo in the terminal: rows and key commands of the demo's service, which runs in a process of its own."""

from __future__ import annotations

import asyncio
import contextlib
import json
import tempfile
from collections.abc import Coroutine, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from drivebus.cli import output
from drivebus.cli.demo.layout import BUSES
from drivebus.cli.demo.script import drive_name, outcome_text, stop_all_text
from drivebus.cli.remote.client import LocalClient
from drivebus.cli.tui.rows import BusRow, DriveRow
from drivebus.cli.tui.service_source import ServiceRowSource
from drivebus.errors import DrivebusError, ServiceUnavailable
from drivebus.service.api.operations.control import LEASE_TAKE
from drivebus.service.api.operations.drives import (
    DRIVE_RESET,
    DRIVE_RUN,
    DRIVE_SET_FREQUENCY,
    DRIVE_STOP,
    DRIVES_GET,
    START_INHIBIT_RELEASE,
)
from drivebus.service.api.operations.plant import PLANT_STOP
from drivebus.service.process.module_command import module_command
from drivebus.types import Json

DEFAULT_RUN_HZ = 25.0  # frequency of "run" for a drive that had none
MIN_SETPOINT_HZ = 5.0  # lowest setpoint of the keys + and -
MAX_SETPOINT_HZ = 50.0
MAX_LOG_CHARACTERS = 2000
CLOSE_TIMEOUT_S = 15.0  # the service stops its drives at its end; then it is killed


class DemoClient:
    """Row source and key commands of the view; starts and ends the process of the service."""

    def __init__(self, *, memory: bool = False) -> None:
        drives = sum(len(bus.drives) for bus in BUSES)
        kind = "memory" if memory else "pty"
        self.title = output.text(f"demo.title.{kind}", drives=drives, buses=len(BUSES))
        self._memory = memory
        self._process: asyncio.subprocess.Process | None = None
        self._log = tempfile.NamedTemporaryFile("w+", prefix="drivebus-demo-", suffix=".log")  # noqa: SIM115
        self._rows: ServiceRowSource | None = None
        self._client: LocalClient | None = None
        self._messages: list[str] = []
        self._finished = False
        self._tasks: set[asyncio.Task[None]] = set()

    async def start(self) -> None:
        """Start the service and connect to it. Raises ServiceUnavailable if it ends first."""
        options = ["--lang", output.language(), *(["--memory"] if self._memory else [])]
        self._process = await asyncio.create_subprocess_exec(
            *module_command("drivebus.cli.demo.host", *options),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=self._log,
            start_new_session=True,
        )
        assert self._process.stdout is not None
        line = await self._process.stdout.readline()
        if not line:
            self._log.seek(0)
            raise ServiceUnavailable("demo.failed_to_start", log=self._log.read()[-MAX_LOG_CHARACTERS:])
        ready = json.loads(line)
        self._rows = ServiceRowSource(ready["socket"])
        await self._rows.start()
        self._client = LocalClient(Path(ready["socket"]))
        self._spawn(self._read_messages())

    async def close(self) -> None:
        """End the service: it stops its drives first."""
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        if self._rows is not None:
            await self._rows.close()
        if self._client is not None:
            await self._client.close()
        process, self._process = self._process, None
        if process is not None and process.stdin is not None:
            process.stdin.close()
            try:
                await asyncio.wait_for(process.communicate(), CLOSE_TIMEOUT_S)
            except TimeoutError:
                with contextlib.suppress(ProcessLookupError):
                    process.kill()
                await process.wait()
        self._log.close()

    # --- rows -----------------------------------------------------------------------------------------------------

    def now(self) -> float:
        return self._rows.now() if self._rows is not None else 0.0

    def drives(self) -> list[DriveRow]:
        rows = self._rows.drives() if self._rows is not None else []
        return [replace(row, name=drive_name(row.key)) for row in rows]

    def buses(self) -> Sequence[BusRow]:
        return self._rows.buses() if self._rows is not None else []

    def messages(self) -> list[str]:
        return self._messages

    @property
    def finished(self) -> bool:
        return self._finished

    async def _read_messages(self) -> None:
        assert self._process is not None and self._process.stdout is not None
        while line := await self._process.stdout.readline():
            message = json.loads(line)
            if "message" in message:
                self._messages.append(message["message"])
            self._finished = self._finished or "finished" in message
        self._finished = True

    # --- keys -----------------------------------------------------------------------------------------------------

    def run(self, key: str) -> None:
        self._command(key, "run", DRIVE_RUN.name, frequency_hz=self._frequency_hz(key))

    def stop(self, key: str) -> None:
        self._command(key, "stop", DRIVE_STOP.name)

    def change_frequency(self, key: str, by_hz: float) -> None:
        frequency_hz = min(MAX_SETPOINT_HZ, max(MIN_SETPOINT_HZ, self._frequency_hz(key) + by_hz))
        self._command(key, "set", DRIVE_SET_FREQUENCY.name, frequency_hz=frequency_hz)

    def reset(self, key: str) -> None:
        self._take_over()
        self._report("demo.reset", name=drive_name(key))
        self._spawn(self._reset(key))

    def stop_all(self) -> None:
        self._take_over()
        self._report("demo.stop_all")
        self._spawn(self._stop_all())

    def _frequency_hz(self, key: str) -> float:
        row = next((row for row in self.drives() if row.key == key), None)
        return (row.commanded_hz if row is not None else None) or DEFAULT_RUN_HZ

    def _take_over(self) -> None:
        """End the script at the first key."""
        if self._process is not None and self._process.stdin is not None:
            self._process.stdin.write(b"take over\n")

    def _command(self, key: str, action: str, operation: str, **params: float) -> None:
        self._take_over()
        self._report(f"demo.{action}", name=drive_name(key), hz=f"{params.get('frequency_hz', 0.0):g}")
        self._spawn(self._execute(key, operation, params))

    async def _execute(self, key: str, operation: str, params: Json) -> None:
        assert self._client is not None
        name = drive_name(key)
        try:
            if operation != DRIVE_STOP.name:
                await self._client.call(LEASE_TAKE.name, {"drive": key})
            result = await self._client.call(operation, {"drive": key, **params})
        except DrivebusError as error:
            is_inhibited = error.key in ("drives.start_inhibited", "bus.start_inhibited")
            self._report(
                "demo.inhibited" if is_inhibited else "demo.failed", name=name, text=error.text(output.language())
            )
        else:
            self._report("demo.outcome", name=name, text=outcome_text(result))

    async def _reset(self, key: str) -> None:
        """Reset the fault, after releasing a start inhibit."""
        assert self._client is not None
        with contextlib.suppress(DrivebusError):
            if (await self._client.call(DRIVES_GET.name, {"drive": key}))["start_inhibited"]:
                await self._client.call(LEASE_TAKE.name, {"drive": key})
                await self._client.call(START_INHIBIT_RELEASE.name, {"drive": key})
                self._report("demo.released", name=drive_name(key))
        await self._execute(key, DRIVE_RESET.name, {})

    async def _stop_all(self) -> None:
        assert self._client is not None
        try:
            self._report("demo.stopped_all", text=stop_all_text(await self._client.call(PLANT_STOP.name, {})))
        except DrivebusError as error:
            self._messages.append(error.text(output.language()))

    def _report(self, message_key: str, **params: Any) -> None:
        self._messages.append(output.text(message_key, **params))

    def _spawn(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
