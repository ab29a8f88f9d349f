"""Rows of a service's plant, read from the service once a second. Sends no command and polls no bus."""

from __future__ import annotations

import asyncio
import contextlib
import time
from dataclasses import replace

from drivebus.cli import output
from drivebus.cli.remote.client import RemoteClient, open_client
from drivebus.cli.remote.convert import parse_status
from drivebus.cli.tui.rows import COLUMN_SIGNALS, ERROR_COUNTERS, BusRow, DriveRow, drive_row
from drivebus.errors import DrivebusError
from drivebus.service.api.operations.buses import BUSES_LIST
from drivebus.service.api.operations.drives import DRIVES_LIST
from drivebus.service.api.operations.plant import PLANT_GET
from drivebus.types import Json

SERVICE_POLL_PERIOD_S = 1.0


class ServiceRowSource:
    """Row source of a service; while the service does not answer, every drive is shown as offline."""

    finished = False

    def __init__(self, service: str) -> None:
        self.title = service
        self._service = service
        self._exit_stack = contextlib.AsyncExitStack()
        self._polling: asyncio.Task[None] | None = None
        self._drives: list[DriveRow] = []
        self._buses: list[BusRow] = []
        self._messages = [output.text("service.rows_source")]
        self._unreachable = False

    async def start(self) -> None:
        """Connect and read the first rows. Raises the errors of the service."""
        client = await self._exit_stack.enter_async_context(open_client(self._service))
        plant = await client.call(PLANT_GET.name, {})
        await self._fetch(client)
        name = plant["title"][output.language()] or plant["id"]
        self.title = output.text("service.title", service=self._service, count=len(self._drives), plant=name)
        self._polling = asyncio.create_task(self._poll(client), name="service-rows")

    async def close(self) -> None:
        if self._polling is not None:
            self._polling.cancel()
            await asyncio.gather(self._polling, return_exceptions=True)
        await self._exit_stack.aclose()

    def now(self) -> float:
        return time.monotonic()

    def drives(self) -> list[DriveRow]:
        return self._drives

    def buses(self) -> list[BusRow]:
        return self._buses

    def messages(self) -> list[str]:
        return self._messages

    async def _poll(self, client: RemoteClient) -> None:
        while True:
            await asyncio.sleep(SERVICE_POLL_PERIOD_S)
            try:
                await self._fetch(client)
            except DrivebusError as error:
                self._mark_unreachable(error)

    async def _fetch(self, client: RemoteClient) -> None:
        drives, buses = await client.call(DRIVES_LIST.name, {}), await client.call(BUSES_LIST.name, {})
        now = self.now()
        self._drives = [remote_drive_row(view, now) for view in drives["drives"]]
        self._buses = [remote_bus_row(view) for view in buses["buses"]]
        if self._unreachable:
            self._unreachable = False
            self._messages.append(output.text("service.back"))

    def _mark_unreachable(self, error: DrivebusError) -> None:
        """Replace outdated rows by rows without values, and report the reason once."""
        self._drives = [
            replace(row, presence="offline", state="unknown", reason=None, readings={}) for row in self._drives
        ]
        self._buses = [replace(row, up=False, load=None, transactions_per_s=None) for row in self._buses]
        if not self._unreachable:
            self._unreachable = True
            self._messages.append(output.text("service.out_of_reach", why=error))


def remote_drive_row(view: Json, now: float) -> DriveRow:
    """Return the row of a DriveView."""
    status = parse_status(view, now)
    readings = {name: reading for name, reading in status.readings.items() if name in COLUMN_SIGNALS}
    row = drive_row(
        replace(status, readings=readings),
        key=view["id"],
        name=view["id"],
        bus=view["bus"],
        model=view["model"],
        address=view["address"],
        presence=view["presence"],
        has_duplicate_address=any(blocker["key"] == "drives.duplicate" for blocker in view["start_blockers"]),
    )
    return replace(row, commanded_hz=view["commanded_hz"])


def remote_bus_row(view: Json) -> BusRow:
    """Return the row of a BusView."""
    counters = {kind: count for kind, count in view["counters"].items() if kind in ERROR_COUNTERS}
    errors = {**view["errors"], **counters}
    return BusRow(
        name=view["id"],
        settings=view["serial"],
        up=view["is_open"],
        load=view["load_percent"] / 100.0,
        transactions_per_s=view["transactions_per_s"],
        errors=errors,
    )
