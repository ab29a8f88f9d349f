"""The plant process from its lock to its last stop: what ``drivebus serve`` runs."""

from __future__ import annotations

import asyncio
import errno
import logging
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import AsyncExitStack, contextmanager
from typing import Any

from drivebus.bus import timer as timers
from drivebus.errors import DrivebusError
from drivebus.plant.access.child import Announce, command
from drivebus.plant.assemble import Rooms
from drivebus.plant.lock import only_one
from drivebus.plant.model import PlantSetting
from drivebus.plant.notify import Notify
from drivebus.plant.precedence import seldom_collect
from drivebus.plant.service import SERVICE, Service
from drivebus.plant.socket_paths import PLANT, STOP
from drivebus.plant.socket_server import SocketServer, StopServer
from drivebus.plant.supervisor import Supervisor
from drivebus.seams import wall_ms

Json = dict[str, Any]
LOG = logging.getLogger("drivebus.plant")
ENDINGS = (signal.SIGTERM, signal.SIGINT)


async def run(
    setting: PlantSetting, *, web: bool = True, announce: Announce = "plain", ready: Callable[[], None] = lambda: None
) -> Json:
    """Until SIGTERM or Ctrl-C; returns what became of each drive that the service had started (None: not told in time).

    Raises ConfigurationError: the plant runs already, its directory or a socket can't be used.
    """
    loop = asyncio.get_running_loop()
    notify, ending = Notify(), asyncio.Event()
    with only_one(setting.directory), heeding(loop, ending) as on_reload:
        async with AsyncExitStack() as stack:
            rooms = Rooms(setting, lambda: timers.clock_of(loop), wall_ms)
            stack.push_async_callback(rooms.close)
            service = Service(setting, await rooms.open())
            service.watching.after_look = lambda now: notify.feed(service.plant.lines.values(), now)
            await service.start()
            on_reload.append(lambda: _reload(service))
            servers = (SocketServer(service, setting.directory / PLANT), StopServer(service, setting.directory / STOP))
            for server in servers:
                await server.open()
                stack.push_async_callback(server.close)
            child = Supervisor(command(setting, setting.directory / PLANT, announce), service.plant.now, _web_ended)
            if web and setting.web.enabled:
                child.start()
            seldom_collect()
            notify.say("READY=1")
            ready()
            await ending.wait()
            notify.say("STOPPING=1")
            found, _ = await asyncio.gather(service.stop(), child.close())
    return found


def _web_ended(code: int) -> None:
    LOG.warning("the web process ended with %s; it is started again; buses, stops and history go on", code)


async def _reload(service: Service) -> None:
    try:
        await service.call("configuration.reload", {}, SERVICE)
    except DrivebusError as error:
        LOG.error("nothing was reloaded: %s", error)


Reloads = list[Callable[[], Any]]


@contextmanager
def heeding(loop: asyncio.AbstractEventLoop, ending: asyncio.Event) -> Iterator[Reloads]:
    """SIGTERM, Ctrl-C and a terminal that is gone set ``ending``; any other SIGHUP calls what is put into the list."""
    reloads: Reloads = []
    tasks: set[asyncio.Task[Any]] = set()

    def reload() -> None:
        for each in reloads:
            task = loop.create_task(each())
            tasks.add(task)
            task.add_done_callback(tasks.discard)

    for one in ENDINGS:
        loop.add_signal_handler(one, ending.set)
    loop.add_signal_handler(signal.SIGHUP, lambda: ending.set() if terminal_is_gone() else reload())
    try:
        yield reloads
    finally:
        for one in (*ENDINGS, signal.SIGHUP):
            loop.remove_signal_handler(one)


def terminal_is_gone() -> bool:
    """Its window was closed, or its line broke: nobody reads here, and no Ctrl-C can come. A unit has none to lose."""
    try:
        os.tcgetpgrp(0)
    except OSError as error:
        return error.errno == errno.EIO
    return False
