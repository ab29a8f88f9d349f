"""Supervisor of the gateways: child processes of the service, started, restarted, replaced by a reload, and ended.

The service waits for none of them. A gateway that exits is started again after a pause that doubles while it keeps
exiting.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import replace
from errno import EADDRINUSE
from typing import Any

from drivebus import i18n
from drivebus.errors import SystemReason
from drivebus.service.config.model import GatewayConfig, PlantConfig
from drivebus.service.process.gateway_arguments import (
    ADDRESS_USED_EXIT_CODE,
    AddressOutput,
    GatewayArguments,
    encode_arguments,
    gateway_arguments,
    has_users,
)
from drivebus.service.process.logging_setup import LogFormat
from drivebus.service.process.module_command import module_command
from drivebus.service.runtime.plant import GatewayStatus, Plant, PlantListener

FIRST_RESTART_PAUSE_S = 0.5  # each further exit doubles the pause
MAX_RESTART_PAUSE_S = 30.0
STEADY_RUN_S = 60.0  # after a run of this length the next pause is the first one again
TERMINATE_TIMEOUT_S = 2.0  # a gateway that has not ended by then is killed
RESOLVE_TIMEOUT_S = 1.0  # for the name of a host: a name server that is away does not delay the service
CAN_NOT_START_EXIT_CODE = 127  # what a shell reports for a command that the system can't start
RELOAD_LINE = b"reload\n"
LOG = logging.getLogger("drivebus.service")


class ChildProcess:
    """Child process, restarted when it exits. Its output is the service's own."""

    def __init__(
        self,
        command: Sequence[str],
        arguments: bytes,
        now: Callable[[], float],
        *,
        retry_arguments: bytes | None = None,
        on_start: Callable[[int], None] = lambda pid: None,
        on_exit: Callable[[int, bool], None] = lambda code, repeated: None,
    ) -> None:
        """``arguments`` are written to its standard input, which stays open.

        ``retry_arguments`` take their place after an exit with ``ADDRESS_USED_EXIT_CODE``; None: ``arguments`` always.
        ``on_start`` gets its process id; ``on_exit`` its exit code, and whether it exited soon after a restart.
        """
        self._command, self._now = tuple(command), now
        self._arguments, self._retry_arguments = arguments, retry_arguments or arguments
        self._on_start, self._on_exit = on_start, on_exit
        self._task: asyncio.Task[None] | None = None
        self.process: asyncio.subprocess.Process | None = None

    def start(self, after: asyncio.Task[None] | None = None) -> None:
        """Start it, once the process that it replaces has ended (``after``)."""
        self._task = asyncio.create_task(self._run(after), name=f"gateway {self._command[-1]}")

    async def _run(self, after: asyncio.Task[None] | None) -> None:
        if after is not None:
            await asyncio.wait([after])
        pause_s, repeated = FIRST_RESTART_PAUSE_S, False
        code = None
        while True:
            started_at = self._now()
            is_retry = code == ADDRESS_USED_EXIT_CODE
            code = await self._run_once(self._retry_arguments if is_retry else self._arguments)
            if self._now() - started_at >= STEADY_RUN_S:
                pause_s, repeated = FIRST_RESTART_PAUSE_S, False
            self._on_exit(code, repeated)
            await asyncio.sleep(pause_s)
            pause_s, repeated = min(MAX_RESTART_PAUSE_S, 2 * pause_s), True

    async def _run_once(self, arguments: bytes) -> int:
        """Run it once and return its exit code.

        A process group of its own keeps a terminal's Ctrl-C from it; the service ends it. It gets no session of its
        own: Linux would give that as much processor time as the service.
        """
        try:
            self.process = await asyncio.create_subprocess_exec(
                *self._command, stdin=asyncio.subprocess.PIPE, process_group=0
            )
        except OSError as error:
            reason = SystemReason(error)
            LOG.error(i18n.preferred_text("log.gateway_not_started", gateway=self._command[-1], reason=reason))
            return CAN_NOT_START_EXIT_CODE
        assert self.process.stdin is not None
        self.process.stdin.write(arguments)
        self._on_start(self.process.pid)
        return await self.process.wait()

    def notify_reload(self) -> None:
        """Notify it of a reload that leaves its arguments as they are: one line on its standard input."""
        if self.process is not None and self.process.returncode is None and self.process.stdin is not None:
            self.process.stdin.write(RELOAD_LINE)

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


class GatewaySupervisor(PlantListener):
    """All gateways of a plant; ``plant.gateways`` holds their status."""

    def __init__(
        self,
        plant: Plant,
        *,
        without: Collection[str] = (),
        address_output: AddressOutput = "plain",
        log_format: LogFormat = "text",
    ) -> None:
        """``without``: names of gateways that are not started, also where their table enables them."""
        self._plant, self._without, self._address_output = plant, frozenset(without), address_output
        self._log_format: LogFormat = log_format
        self._had_users = has_users(plant.config)
        self._configs: dict[str, GatewayConfig] = {}
        self._children: dict[str, ChildProcess] = {}
        self._closing: set[asyncio.Task[None]] = set()

    def start(self) -> None:
        """Start every enabled gateway, and follow reloads of the configuration from now on."""
        self._plant.subscribe(self)
        self.on_reload()

    def on_reload(self) -> None:
        """Start what was added, end what was removed, restart what was changed; notify the others."""
        enabled = {gateway.id: gateway for gateway in _enabled_gateways(self._plant.config, self._without)}
        for name in self._configs.keys() - enabled.keys():
            del self._configs[name], self._plant.gateways[name]
            self._end(name)
        for name, config in enabled.items():
            if self._configs.get(name) != config:
                self._start(config)
            else:
                self._children[name].notify_reload()

    def _start(self, config: GatewayConfig) -> None:
        status = self._plant.gateways[config.id] = GatewayStatus(id=config.id)

        def on_start(pid: int) -> None:
            status.pid = pid
            status.starts += 1

        def on_exit(code: int, repeated: bool) -> None:
            status.pid, status.exit_code = None, code
            self._report_exit(config.id, code, repeated=repeated)

        replaced = self._end(config.id) if config.id in self._children else None
        arguments = self._arguments(config)
        child = ChildProcess(
            module_command(config.module),
            encode_arguments(arguments),
            self._plant.now,
            retry_arguments=encode_arguments(replace(arguments, address_use_reported=True)),
            on_start=on_start,
            on_exit=on_exit,
        )
        self._configs[config.id], self._children[config.id] = config, child
        child.start(after=replaced)

    def _arguments(self, config: GatewayConfig) -> GatewayArguments[Any]:
        return gateway_arguments(
            self._plant.config, config, self._address_output, self._log_format, had_users=self._had_users
        )

    def _end(self, name: str) -> asyncio.Task[None]:
        task = asyncio.create_task(self._children.pop(name).close(), name=f"end gateway {name}")
        self._closing.add(task)
        task.add_done_callback(self._closing.discard)
        return task

    def _report_exit(self, name: str, code: int, *, repeated: bool) -> None:
        """Publish an event; of a gateway that keeps exiting only the first one, so that it fills no history."""
        if repeated:
            LOG.warning(i18n.preferred_text("log.gateway_ended_again", gateway=name, code=code))
        else:
            self._plant.publish_event("gateway", None, "plant.gateway_ended", gateway=name, code=code)

    async def close(self) -> None:
        """End every gateway."""
        await asyncio.gather(*(child.close() for child in self._children.values()), *self._closing)


async def report_used_ports(config: PlantConfig, without: Collection[str]) -> None:
    """Log each gateway at whose address another program listens, before a process of this service does.

    What else is wrong with an address is reported by the process of the gateway.
    """
    for gateway in _enabled_gateways(config, without):
        if gateway.listens_at is None:
            continue
        host, port = gateway.listens_at
        try:
            async with asyncio.timeout(RESOLVE_TIMEOUT_S):
                await _check_can_listen(host, port)
        except (OSError, UnicodeError) as error:  # UnicodeError: no name of a host, such as plant..local
            if not isinstance(error, OSError) or error.errno != EADDRINUSE:
                continue
            params = {"gateway": gateway.id, "host": host, "port": port, "reason": SystemReason(error)}
            LOG.error(i18n.preferred_text("log.gateway_port_used", **params))


def _enabled_gateways(config: PlantConfig, without: Collection[str]) -> Iterator[GatewayConfig]:
    return (gateway for gateway in config.gateways if gateway.enabled and gateway.id not in without)


async def _check_can_listen(host: str, port: int) -> None:
    """Check that no other program listens at an address of this machine. Raises OSError, UnicodeError, TimeoutError."""
    loop = asyncio.get_running_loop()
    family, kind, protocol, _, address = (await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM))[0]
    with socket.socket(family, kind, protocol) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind(address)
