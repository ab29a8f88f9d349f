"""The live view of a service's plant: looks once a second, commands nothing, polls no bus."""

from __future__ import annotations

import asyncio
import contextlib
import time
from typing import Any

from drivebus.cli import voice
from drivebus.cli.live.model import SIGNALS, DriveRow, LineRow
from drivebus.cli.service.client import Client, opened
from drivebus.cli.service.said import status_of
from drivebus.errors import DrivebusError

Json = dict[str, Any]

PERIOD_S = 1.0


class ServiceFeed:
    """A ``Feed``. While the service does not answer every drive is shown as silent, and the news say why."""

    over = False

    def __init__(self, service: str) -> None:
        self.title = service
        self._service = service
        self._open = contextlib.AsyncExitStack()
        self._looking: asyncio.Task[None] | None = None
        self._drives: list[DriveRow] = []
        self._lines: list[LineRow] = []
        self._news = [voice.say("service.feeds")]
        self._is_lost = False

    async def start(self) -> None:
        """Raises what the service says to the first look."""
        client = await self._open.enter_async_context(opened(self._service))
        plant = await client.call("plant.get", {})
        await self._look(client)
        name = plant["title"][voice.language()] or plant["id"]
        self.title = voice.say("service.title", service=self._service, count=len(self._drives), plant=name)
        self._looking = asyncio.create_task(self._look_on(client), name="look")

    async def close(self) -> None:
        if self._looking is not None:
            self._looking.cancel()
            await asyncio.gather(self._looking, return_exceptions=True)
        await self._open.aclose()

    def now(self) -> float:
        return time.monotonic()

    def drives(self) -> list[DriveRow]:
        return self._drives

    def lines(self) -> list[LineRow]:
        return self._lines

    def news(self) -> list[str]:
        return self._news

    async def _look_on(self, client: Client) -> None:
        while True:
            await asyncio.sleep(PERIOD_S)
            try:
                await self._look(client)
            except DrivebusError as error:
                self._lost(error)

    async def _look(self, client: Client) -> None:
        drives, buses = await client.call("drives.list", {}), await client.call("buses.list", {})
        now = self.now()
        self._drives = [drive_row(view, now) for view in drives["drives"]]
        self._lines = [line_row(view) for view in buses["buses"]]
        if self._is_lost:
            self._is_lost = False
            self._news.append(voice.say("service.back"))

    def _lost(self, error: DrivebusError) -> None:
        """Nothing that was seen before stands there as if it were now."""
        from dataclasses import replace

        self._drives = [replace(row, presence="silent", state="unknown", readings={}) for row in self._drives]
        self._lines = [replace(line, up=False, load=None, transactions_per_s=None) for line in self._lines]
        if not self._is_lost:
            self._is_lost = True
            self._news.append(voice.say("service.out_of_reach", why=error))


def drive_row(view: Json, now: float) -> DriveRow:
    """A DriveView as a row."""
    status = status_of(view, now)
    readings = {name: one for name, one in status.readings.items() if name in SIGNALS}
    times = [one.source_time for one in readings.values() if one.source_time is not None]
    fault = status.fault
    return DriveRow(
        view["id"], view["id"], view["bus"], view["model"], view["address"], str(status.state),
        str(status.direction) if status.direction else None, fault.label if fault else "",
        voice.plain(fault.text) if fault else "", readings, view["presence"], min(times, default=None),
        view["commanded_hz"],
    )  # fmt: skip


def line_row(view: Json) -> LineRow:
    """A BusView as a row."""
    errors = {**view["errors"], **view["counters"]}
    return LineRow(
        view["id"], view["line"], view["is_open"], view["load_percent"] / 100.0, view["transactions_per_s"], errors
    )
