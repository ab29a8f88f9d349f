"""Main function of ``drivebus serve``: lock, service, sockets, gateways and signals."""

from __future__ import annotations

import asyncio
import logging
import signal
from collections.abc import AsyncIterator, Callable, Collection, Iterator
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager, suppress
from pathlib import Path
from typing import Any

from drivebus import i18n
from drivebus.errors import ConfigurationError, DrivebusError, SystemReason
from drivebus.service.api.operations.plant import CONFIGURATION_RELOAD
from drivebus.service.app import SERVICE_ACTOR, Service, build_service
from drivebus.service.config.model import PlantConfig
from drivebus.service.ipc.protocol import (
    SERVICE_SOCKET,
    STOP_SOCKET,
    create_runtime_folder,
    remove_runtime_folders,
    short_socket_path,
    socket_path,
)
from drivebus.service.ipc.server import SocketServer, StopServer
from drivebus.service.process.gateway_arguments import AddressOutput
from drivebus.service.process.gateways import GatewaySupervisor, report_used_ports
from drivebus.service.process.lock import single_instance
from drivebus.service.process.logging_setup import AT_LONG_INTERVALS, LogFormat
from drivebus.service.process.permissions import check_plant_files
from drivebus.service.process.systemd import SystemdNotifier
from drivebus.service.process.tuning import raise_file_limit, relax_gc
from drivebus.terminal import discard_terminal_output, terminal_is_closed
from drivebus.types import Json

LOG = logging.getLogger("drivebus.service")
SOCKET_CHECK_INTERVAL_S = 2.0  # a socket that was removed is missing for so long at most
TERMINATION_SIGNALS = (signal.SIGTERM, signal.SIGINT)


async def run_service(
    config: PlantConfig,
    *,
    without: Collection[str] = (),
    address_output: AddressOutput = "plain",
    log_format: LogFormat = "text",
    on_ready: Callable[[Service], None] = lambda service: None,
    reloads_on_hangup: bool = True,
) -> Json:
    """Run the service until a signal; return the outcomes of ``StopCommands.stop_started_drives``.

    ``without`` names gateways that are not started; ``reloads_on_hangup`` False: SIGHUP ends it, as SIGTERM does.
    Raises ConfigurationError: the service runs already, its directory or socket can't be used, others could write its
    files.
    """
    raise_file_limit()
    loop = asyncio.get_running_loop()
    notify, ending = SystemdNotifier(), asyncio.Event()
    check_plant_files(config)
    with (
        single_instance(config.directory),
        handle_signals(loop, ending, reloads_on_hangup=reloads_on_hangup) as on_reload,
    ):
        await _check_no_service_answers(config.directory)
        await report_used_ports(config, without)
        async with AsyncExitStack() as stack:
            service = await stack.enter_async_context(build_service(config, watchdog=notify))
            await service.start()
            on_reload.append(lambda: _reload(service))
            await stack.enter_async_context(_service_sockets(service, config.directory))
            gateways = GatewaySupervisor(
                service.plant, without=without, address_output=address_output, log_format=log_format
            )
            gateways.start()
            relax_gc()
            notify.send("READY=1")
            on_ready(service)
            await ending.wait()
            notify.send("STOPPING=1")
            try:
                outcomes = await service.stop()
            finally:
                await gateways.close()  # only now: until its drives are stopped, the page can stop them, too
    return outcomes


async def _check_no_service_answers(directory: Path) -> None:
    """Check that no service listens in the directory: its lock is gone where the directory was removed meanwhile.

    Raises ConfigurationError.
    """
    with suppress(OSError), short_socket_path(socket_path(directory, STOP_SOCKET)) as short:
        _, writer = await asyncio.open_unix_connection(short)
        writer.close()
        raise ConfigurationError("plant.runs_already", directory=str(directory))


@asynccontextmanager
async def _service_sockets(service: Service, directory: Path) -> AsyncIterator[None]:
    """Serve both sockets in the state directory, or in a runtime folder where it cannot be written.

    Raises ConfigurationError where neither is possible.
    """
    async with AsyncExitStack() as stack:
        try:
            servers = await _listen(service, directory, stack)
            remove_runtime_folders(directory)
        except OSError as error:
            await stack.aclose()
            try:
                folder = create_runtime_folder(directory)
                stack.callback(remove_runtime_folders, directory)
                servers = await _listen(service, folder, stack)
            except OSError as failure:
                reason = SystemReason(failure)
                raise ConfigurationError("plant.directory", directory=str(directory), reason=reason) from failure
            reason = SystemReason(error)
            LOG.error(i18n.preferred_text("log.sockets_elsewhere", directory=directory, reason=reason, folder=folder))
        restoring = asyncio.create_task(_restore_sockets(servers))
        stack.callback(restoring.cancel)
        yield


async def _listen(service: Service, folder: Path, stack: AsyncExitStack) -> tuple[SocketServer, StopServer]:
    """Open both sockets. Raises OSError."""
    servers = SocketServer(service, folder / SERVICE_SOCKET), StopServer(service, folder / STOP_SOCKET)
    for server in servers:
        await server.open()
        stack.push_async_callback(server.close)
    return servers


async def _restore_sockets(servers: tuple[SocketServer, StopServer]) -> None:
    """Open each socket again that was removed or replaced: without them a stop on this machine finds no service."""
    missing: set[Path] = set()
    accepting: dict[Path, tuple[int, int, int]] = {}
    while True:
        await asyncio.sleep(SOCKET_CHECK_INTERVAL_S)
        for server in servers:
            try:
                if server.path.is_socket() and await _accepts_connections(server.path, accepting):
                    missing.discard(server.path)
                    continue
                await server.open()
            except OSError as error:
                if server.path not in missing:
                    text = i18n.preferred_text("log.socket_missing", socket=server.path, reason=SystemReason(error))
                    LOG.error(text, extra=AT_LONG_INTERVALS)
                missing.add(server.path)
            else:
                text = i18n.preferred_text("log.socket_restored", socket=server.path)
                LOG.warning(text, extra=AT_LONG_INTERVALS)
                missing.discard(server.path)


async def _accepts_connections(path: Path, accepting: dict[Path, tuple[int, int, int]]) -> bool:
    """Return whether a program listens at a socket; the same file is tried only once. Raises OSError.

    A state directory that was moved away and back has the socket file that nothing listens at any more.
    """
    identity = _file_identity(path)
    if accepting.get(path) != identity:
        try:
            with short_socket_path(path) as short:
                _, writer = await asyncio.open_unix_connection(short)
        except ConnectionRefusedError:
            return False
        writer.close()
        accepting[path] = identity
    return True


def _file_identity(path: Path) -> tuple[int, int, int]:
    status = path.stat()
    return status.st_dev, status.st_ino, status.st_ctime_ns


async def _reload(service: Service) -> None:
    try:
        await service.call(CONFIGURATION_RELOAD.name, {}, SERVICE_ACTOR)
    except DrivebusError as error:
        LOG.error(i18n.preferred_text("log.not_reloaded", why=error))


ReloadCallbacks = list[Callable[[], Any]]


@contextmanager
def handle_signals(
    loop: asyncio.AbstractEventLoop, ending: asyncio.Event, *, reloads_on_hangup: bool
) -> Iterator[ReloadCallbacks]:
    """Set ``ending`` on SIGTERM, Ctrl-C and a closed terminal; call the yielded callbacks on any other SIGHUP.

    Ctrl-Z is only reported: suspended, the service would neither watch its motors nor send a stop of the page.
    ``reloads_on_hangup`` False: every SIGHUP sets it, also of a closed terminal that is not the standard input.
    """
    reloads: ReloadCallbacks = []
    tasks: set[asyncio.Task[Any]] = set()

    def end_without_terminal() -> None:
        if terminal_is_closed():
            discard_terminal_output()
            ending.set()

    def on_hangup() -> None:
        end_without_terminal()
        if not reloads_on_hangup:
            discard_terminal_output()
            ending.set()
        if ending.is_set():
            return
        for reload in reloads:
            task = loop.create_task(reload())
            tasks.add(task)
            task.add_done_callback(tasks.discard)

    def on_suspend() -> None:
        LOG.warning(i18n.preferred_text("log.not_suspended"))

    for number in TERMINATION_SIGNALS:
        loop.add_signal_handler(number, ending.set)
    loop.add_signal_handler(signal.SIGTSTP, on_suspend)
    loop.add_signal_handler(signal.SIGHUP, on_hangup)
    end_without_terminal()  # it may have been closed during the start, when SIGHUP is ignored
    try:
        yield reloads
    finally:
        for number in (*TERMINATION_SIGNALS, signal.SIGHUP, signal.SIGTSTP):
            loop.remove_signal_handler(number)
