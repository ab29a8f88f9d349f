"""A whole plant with its page for a real browser: simulated drives, real rooms, a real server on loopback that can be
lost and regained. It lives in a thread of its own; the browser's driver needs the test's.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import uvicorn
from fastapi import FastAPI

from doorkit import PASSWORD, QUICK, USERS
from drivebus.bus import timer as timers
from drivebus.drives import MemoryStore
from drivebus.errors import DrivebusError
from drivebus.plant.access.access import Access
from drivebus.plant.access.passwords import Passwords
from drivebus.plant.assemble import Rooms
from drivebus.plant.config import load
from drivebus.plant.service import Service
from drivebus.seams import wall_ms
from drivebus.sim.port import SimPort, forget_benches
from drivebus.web.app import make_app
from drivebus.web.server import Server, bound, config
from plantkit import LOCAL

T = TypeVar("T")
WAIT_S = 40.0
PATIENCE_S = 0.5

PLANT = """
format = 1
[plant]
id = "boiler-house"
title = { en = "Boiler house", zh = "锅炉房" }
directory = "state"
[bus.fans]
link = "sim://c320@1,2,3?ramp=2"
title = { en = "Fan line", zh = "风机线路" }
[bus.pumps]
link = "sim://vc660@1,2?ramp=2"
title = { en = "Pump line", zh = "水泵线路" }
[drive.fan-1]
bus = "fans"
address = 1
model = "c320"
title = { en = "Supply fan", zh = "送风机" }
limits = { maximum_hz = 45.0 }
[drive.fan-2]
bus = "fans"
address = 2
model = "c320"
title = { en = "Extract fan", zh = "排风机" }
[drive.fan-3]
bus = "fans"
address = 3
model = "c320"
title = { en = "Flue gas fan", zh = "引风机" }
[drive.pump-1]
bus = "pumps"
address = 1
model = "vc660"
title = { en = "Circulation pump", zh = "循环泵" }
[drive.pump-2]
bus = "pumps"
address = 2
model = "vc660"
title = { en = "Feed pump", zh = "给水泵" }
[group.air]
drives = ["fan-1", "fan-2", "fan-3"]
title = { en = "Air", zh = "送引风" }
[group.water]
drives = ["pump-1", "pump-2"]
title = { en = "Water", zh = "水系统" }
"""


class Stage:
    """``at`` is the page's address. Users have the names of their roles, and all the same ``PASSWORD``."""

    def __init__(self, directory: Path) -> None:
        self.at = ""
        self.service: Any = None
        self.access: Any = None
        self._directory = directory
        self._loop = asyncio.new_event_loop()
        self._ready, self._ending = threading.Event(), asyncio.Event()
        self._app: FastAPI | None = None
        self._server: Server | None = None
        self._serving: asyncio.Task[None] | None = None
        self._port = 0
        self._thread = threading.Thread(target=self._loop.run_until_complete, args=(self._live(),), daemon=True)
        self._error: BaseException | None = None

    def open(self) -> None:
        """Raises whatever hinders it."""
        self._thread.start()
        assert self._ready.wait(WAIT_S), "the stage does not begin"
        if self._error is not None:
            raise self._error

    def close(self) -> None:
        self._loop.call_soon_threadsafe(self._ending.set)
        self._thread.join(WAIT_S)

    def do(self, act: Callable[[], Coroutine[Any, Any, T]]) -> T:
        """Run something in the plant's loop."""
        return asyncio.run_coroutine_threadsafe(act(), self._loop).result(WAIT_S)

    def call(self, operation: str, **params: Any) -> Any:
        """Ask the plant, as whoever sits at its own machine."""
        return self.do(lambda: self.service.call(operation, params, LOCAL))

    def station(self, drive: str, act: Callable[[Any], T]) -> T:
        """Do something with the simulated drive itself, in its own loop."""

        async def there() -> T:
            unit = self.service.plant.units[drive]
            port: Any = unit.bus.port
            assert isinstance(port, SimPort)
            return act(port.bench.station(unit.setting.address))

        return self.do(there)

    def view(self, drive: str) -> Any:
        """The drive as the plant sees it."""
        return self.call("drives.get", drive=drive)

    def wait(self, ready: Callable[[], bool], why: str) -> None:
        """Real drives take real time."""
        until = time.monotonic() + WAIT_S
        while not ready():
            assert time.monotonic() < until, why
            time.sleep(0.05)

    def lose_server(self) -> None:
        """The web part is gone, with every connection; the plant goes on."""
        self.do(self._down)

    def regain_server(self) -> None:
        self.do(self._up)

    def calm(self) -> None:
        """As at the beginning: everything stopped, nothing latched, no waiver, no lease, no alarm."""
        for drive in self.service.plant.units:
            self.service.plant.leases.forget(drive)
            self.call("drive.release", drive=drive)
            self.wait(lambda drive=drive: self._calmed(drive), f"{drive} is not calm")  # type: ignore[misc]
            self.service.plant.leases.forget(drive)
            if self.view(drive)["host_dies"]["waiver"]:
                self.call("drive.unwaive", drive=drive)
        for alarm in self.call("alarms.list")["active"]:
            self.call("alarm.acknowledge", alarm=alarm["id"])

    def _calmed(self, drive: str) -> bool:
        """A loaded machine answers late, and a drive is silent for a while: then again."""
        view = self.view(drive)
        if view["presence"] == "online" and view["state"] == "stopped":
            return True
        with suppress(DrivebusError):
            self.call("drive.reset" if view["fault"] else "drive.stop", drive=drive)
        return False

    # In its own thread --------------------------------------------------------------------------------------------

    async def _live(self) -> None:
        rooms: Rooms | None = None
        try:
            rooms = await self._open()
            self._ready.set()
            await self._ending.wait()
            await self._down()
            await self.service.stop()
        except BaseException as error:
            self._error = error
            self._ready.set()
        finally:
            if rooms is not None:
                await rooms.close()
            forget_benches()

    async def _open(self) -> Rooms:
        file = self._directory / "plant.toml"
        file.write_text(PLANT, encoding="utf-8")
        setting = load(file)
        setting.directory.mkdir(parents=True, exist_ok=True)
        loop = asyncio.get_running_loop()
        rooms = Rooms(setting, lambda: timers.clock_of(loop), wall_ms)
        kept = MemoryStore()
        self.service = Service(setting, await rooms.open(), store=kept, drive_store=MemoryStore())
        await self.service.start()
        self._have_patience()
        self.access = Access(setting.directory, passwords=Passwords(QUICK))
        self.access.file.change(lambda _: USERS)
        self._app = make_app(self.service, self.access, setting.web)
        await self._up()
        return rooms

    def _have_patience(self) -> None:
        """The simulated wire shares this machine with a browser: an answer that is late by its load is no damaged link,
        for which the gate would rightly refuse to start anything."""
        for unit in self.service.plant.units.values():
            station = unit.bus.core.stations[unit.setting.address]
            station.link = replace(station.link, timing=replace(station.link.timing, adapter_s=PATIENCE_S))

    async def _up(self) -> None:
        listener = bound("127.0.0.1", self._port)
        self._port = listener.getsockname()[1]
        self.at = f"http://127.0.0.1:{self._port}"
        assert self._app is not None
        made: uvicorn.Config = config(self._app, self.service.plant.setting.web)
        made.timeout_graceful_shutdown = 0
        self._server = Server(made)
        self._serving = asyncio.create_task(self._server.serve([listener]))
        while not self._server.started:  # noqa: ASYNC110  uvicorn tells nobody when it has begun
            await asyncio.sleep(0.01)

    async def _down(self) -> None:
        if self._server is None or self._serving is None:
            return
        self._server.should_exit = True
        await self._serving
        self._server = None


@contextmanager
def staged(directory: Path) -> Iterator[Stage]:
    """A plant whose drives all answer."""
    stage = Stage(directory)
    stage.open()
    try:
        views = stage.service.plant.units
        stage.wait(lambda: all(stage.view(drive)["presence"] == "online" for drive in views), "silent drives")
        yield stage
    finally:
        stage.close()


def log_in(page: Any, role: str) -> None:
    """As the user with the name of that role; returns when values are live."""
    page.fill("input[name=name]", role)
    page.fill("input[name=password]", PASSWORD)
    page.click("button[type=submit]")
    page.wait_for_selector(".line.live")
