"""The live view of a service's plant: looks once a second, commands nothing, polls no bus."""

from __future__ import annotations

import asyncio
import contextlib
import time

from drivebus.cli import output
from drivebus.cli.remote.client import RemoteClient, open_client
from drivebus.cli.remote.convert import parse_status
from drivebus.cli.tui.rows import COLUMN_SIGNALS, BusRow, DriveRow
from drivebus.errors import DrivebusError
from drivebus.types import Json

SERVICE_POLL_PERIOD_S = 1.0


class ServiceRowSource:
    """A ``Feed``. While the service does not answer every drive is shown as silent, and the news say why."""

    over = False

    def __init__(self, service: str) -> None:
        self.title = service
        self._service = service
        self._open = contextlib.AsyncExitStack()
        self._polling: asyncio.Task[None] | None = None
        self._drives: list[DriveRow] = []
        self._lines: list[BusRow] = []
        self._news = [output.text("service.feeds")]
        self._unreachable = False

    async def start(self) -> None:
        """Raises what the service says to the first look."""
        client = await self._open.enter_async_context(open_client(self._service))
        plant = await client.call("plant.get", {})
        await self._fetch(client)
        name = plant["title"][output.language()] or plant["id"]
        self.title = output.text("service.title", service=self._service, count=len(self._drives), plant=name)
        self._polling = asyncio.create_task(self._poll(client), name="look")

    async def close(self) -> None:
        if self._polling is not None:
            self._polling.cancel()
            await asyncio.gather(self._polling, return_exceptions=True)
        await self._open.aclose()

    def now(self) -> float:
        return time.monotonic()

    def drives(self) -> list[DriveRow]:
        return self._drives

    def lines(self) -> list[BusRow]:
        return self._lines

    def news(self) -> list[str]:
        return self._news

    async def _poll(self, client: RemoteClient) -> None:
        while True:
            await asyncio.sleep(SERVICE_POLL_PERIOD_S)
            try:
                await self._fetch(client)
            except DrivebusError as error:
                self._mark_unreachable(error)

    async def _fetch(self, client: RemoteClient) -> None:
        drives, buses = await client.call("drives.list", {}), await client.call("buses.list", {})
        now = self.now()
        self._drives = [remote_drive_row(view, now) for view in drives["drives"]]
        self._lines = [remote_bus_row(view) for view in buses["buses"]]
        if self._unreachable:
            self._unreachable = False
            self._news.append(output.text("service.back"))

    def _mark_unreachable(self, error: DrivebusError) -> None:
        """Nothing that was seen before stands there as if it were now."""
        from dataclasses import replace

        self._drives = [replace(row, presence="offline", state="unknown", readings={}) for row in self._drives]
        self._lines = [replace(line, up=False, load=None, transactions_per_s=None) for line in self._lines]
        if not self._unreachable:
            self._unreachable = True
            self._news.append(output.text("service.out_of_reach", why=error))


def remote_drive_row(view: Json, now: float) -> DriveRow:
    """A DriveView as a row."""
    status = parse_status(view, now)
    readings = {name: one for name, one in status.readings.items() if name in COLUMN_SIGNALS}
    times = [one.source_time for one in readings.values() if one.source_time is not None]
    fault = status.fault
    return DriveRow(
        view["id"],
        view["id"],
        view["bus"],
        view["model"],
        view["address"],
        str(status.state),
        str(status.direction) if status.direction else None,
        fault.label if fault else "",
        output.to_json_value(fault.text) if fault else "",
        readings,
        view["presence"],
        min(times, default=None),
        view["commanded_hz"],
    )


def remote_bus_row(view: Json) -> BusRow:
    """A BusView as a row."""
    errors = {**view["errors"], **view["counters"]}
    return BusRow(
        view["id"], view["line"], view["is_open"], view["load_percent"] / 100.0, view["transactions_per_s"], errors
    )
