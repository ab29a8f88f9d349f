"""Main function of a gateway's process: its arguments, its priority, its connection to the service, and its end."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from collections.abc import Awaitable, Callable
from errno import EADDRINUSE
from typing import TypeVar

from drivebus import i18n
from drivebus.errors import ConfigurationError
from drivebus.service.ipc.client import SocketClient
from drivebus.service.process.gateway_arguments import ADDRESS_USED_EXIT_CODE, GatewayArguments, decode_arguments
from drivebus.service.process.logging_setup import configure_logging
from drivebus.service.process.tuning import NICE_GATEWAY, raise_file_limit, set_nice

T = TypeVar("T")
Serve = Callable[[SocketClient, GatewayArguments[T], asyncio.Event], Awaitable[None]]
"""Run a gateway as a client of the service until the event is set. Where it returns earlier, the process ends and the
service starts it again."""


def run_gateway(name: str, settings: type[T], serve: Serve[T], on_reload: Callable[[], None] = lambda: None) -> int:
    """Run a gateway until SIGTERM or the end of the service; return its exit code.

    ``on_reload`` is called after each reload of the configuration that leaves the gateway's settings as they are.
    The code is ``ADDRESS_USED_EXIT_CODE`` where another program uses the address, which is printed once and not at each
    retry, and 2 for other arguments or settings that cannot be used, whose reason is printed.
    """
    set_nice(NICE_GATEWAY)
    raise_file_limit()
    try:
        arguments = decode_arguments(sys.stdin.buffer.readline(), settings)
    except ValueError as error:
        print(f"gateway {name}: drivebus serve starts it: {error}", file=sys.stderr, flush=True)
        return 2
    configure_logging(arguments.log_format)
    try:
        asyncio.run(_run(arguments, serve, on_reload))
    except ConfigurationError as error:
        address_used = _is_of_used_address(error)
        if not (arguments.address_use_reported and address_used):
            print(error.text(i18n.preferred()), file=sys.stderr, flush=True)
        return ADDRESS_USED_EXIT_CODE if address_used else 2
    return 0


def _is_of_used_address(error: ConfigurationError) -> bool:
    return isinstance(error.__cause__, OSError) and error.__cause__.errno == EADDRINUSE


async def _run(arguments: GatewayArguments[T], serve: Serve[T], on_reload: Callable[[], None]) -> None:
    loop, ending = asyncio.get_running_loop(), asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, ending.set)

    def on_input() -> None:
        if os.read(sys.stdin.fileno(), 1024):
            on_reload()
        else:
            loop.remove_reader(sys.stdin.fileno())
            ending.set()

    loop.add_reader(sys.stdin.fileno(), on_input)
    client = SocketClient(arguments.socket)
    try:
        await serve(client, arguments, ending)
    finally:
        await client.close()
