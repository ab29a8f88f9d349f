"""A whole plant with its web part on a loopback port, in a thread and loop of its own: what a program meets."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from argon2 import PasswordHasher

from drivebus.drives import MemoryStore
from drivebus.plant.access.access import Access
from drivebus.plant.access.passwords import Passwords
from drivebus.plant.access.register import Register, Token, User
from drivebus.plant.access.rights import RIGHTS, Right, Role
from drivebus.plant.access.sessions import digest
from drivebus.plant.assemble import Rooms
from drivebus.plant.client import PlantClient
from drivebus.plant.model import WebSetting
from drivebus.plant.service import Service
from drivebus.plant.socket_server import SocketServer
from drivebus.seams import wall_ms
from drivebus.sim.port import forget_benches
from drivebus.web.app import make_app
from drivebus.web.server import LOOPBACK, Server, bound, config
from plantkit import BUSES, Kit, PaperHistory, PaperTrail, setting

PASSWORD = "correct horse battery"
QUICK = PasswordHasher(time_cost=1, memory_cost=8, parallelism=1)
QUICK_BUSES = tuple(replace(bus, link=bus.link.replace("ramp=2", "ramp=1"), baud=19200) for bus in BUSES)
FAR_MS = 4_000_000_000_000


@dataclass
class Served:
    """Where it is, who may come in with which token, and the plant behind it, for its own thread only."""

    url: str
    socket: Path
    kit: Kit
    access: Access
    loop: asyncio.AbstractEventLoop

    def do(self, work: Callable[[], Awaitable[Any]]) -> Any:
        """Run something in the plant's loop; its result."""
        return asyncio.run_coroutine_threadsafe(_awaited(work), self.loop).result(30.0)


def token(role: Role) -> str:
    """The secret of the token that a user of this role has."""
    return f"dbt_{role}"


def register() -> Register:
    """One user of each role, each with a token of all its rights but those of administrators."""
    hashed, found = QUICK.hash(PASSWORD), Register()
    for role in Role:
        rights = tuple(sorted(RIGHTS[role] - {Right.ADMINISTER}))
        found = found.added(User(str(role), role, hashed, 0))
        found = found.with_token(Token(f"id-{role}", "test", str(role), rights, digest(token(role)), 0, FAR_MS))
    return found


@asynccontextmanager
async def whole(directory: Path) -> AsyncIterator[Kit]:
    """A plant over simulated drives with its real trail, history, alarms and cases on disk."""
    chosen, store = setting(buses=QUICK_BUSES, directory=directory), MemoryStore()
    rooms = Rooms(chosen, asyncio.get_running_loop().time, wall_ms)
    try:
        async with Service(chosen, await rooms.open(), store=store, drive_store=MemoryStore()) as service:
            yield Kit(service, PaperTrail(), PaperHistory(), store)
    finally:
        await rooms.close()
        forget_benches()


@contextmanager
def served(directory: Path, client: Callable[[Kit], PlantClient] = lambda kit: kit.service) -> Iterator[Served]:
    """``client`` puts another ``PlantClient`` between the web part and the plant."""
    begun: list[Served] = []
    ready, ending = threading.Event(), asyncio.Event()
    access = Access(directory, passwords=Passwords(QUICK))
    access.file.change(lambda _: register())

    async def serve() -> None:
        async with whole(directory) as kit:
            listener = bound(LOOPBACK, 0)
            web = WebSetting(port=listener.getsockname()[1])
            server = Server(config(make_app(client(kit), access, web), web))
            serving = asyncio.create_task(server.serve([listener]))
            while not server.started:  # noqa: ASYNC110  uvicorn tells nobody
                await asyncio.sleep(0.01)
            socket = SocketServer(kit.service, directory / "plant.sock")
            await socket.open()
            url = f"http://{LOOPBACK}:{web.port}"
            begun.append(Served(url, socket.path, kit, access, asyncio.get_running_loop()))
            ready.set()
            await ending.wait()
            await socket.close()
            server.should_exit = True
            await serving

    thread = threading.Thread(target=lambda: asyncio.run(serve()), name="served")
    thread.start()
    try:
        assert ready.wait(30.0)
        yield begun[0]
    finally:
        if begun:
            begun[0].loop.call_soon_threadsafe(ending.set)
        thread.join(30.0)


async def _awaited(work: Callable[[], Awaitable[Any]]) -> Any:
    return await work()
