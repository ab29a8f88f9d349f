"""``python -m drivebus.web SOCKET [ARGUMENTS]``: the web process, started by the service."""

from __future__ import annotations

import asyncio
import json
import os
import sys
from contextlib import suppress

from drivebus import i18n
from drivebus.errors import ConfigurationError
from drivebus.service.auth.service import AuthService
from drivebus.service.ipc.client import SocketClient
from drivebus.service.process.tuning import NICE_WEB, relax_gc, set_nice
from drivebus.service.process.web_args import WebArguments, parse_web_arguments
from drivebus.web.app import make_app
from drivebus.web.server import HttpServer, listen_host

_PARENT_CHECK_INTERVAL_S = 1.0


def main(arguments: list[str]) -> int:
    """Run the web process; return 2 for arguments, an address or a certificate that cannot be used."""
    set_nice(NICE_WEB)
    try:
        socket, web = parse_web_arguments(arguments)
        asyncio.run(_run(SocketClient(socket), web))
    except ConfigurationError as error:
        print(error.text(i18n.preferred()), file=sys.stderr, flush=True)
        return 2
    except ValueError as error:
        print(f"python -m drivebus.web: {error}", file=sys.stderr, flush=True)
        return 2
    return 0


async def _run(client: SocketClient, arguments: WebArguments) -> None:
    auth = AuthService(arguments.directory, arguments.user_file)
    app = make_app(client, auth, arguments.web)
    server = HttpServer(app, auth, arguments.web, lambda address: _announce(address, auth, arguments))
    relax_gc()
    parent_watch = asyncio.create_task(_stop_with_parent(server, arguments.parent_pid))
    try:
        await server.run()
    finally:
        parent_watch.cancel()
        with suppress(asyncio.CancelledError):
            await parent_watch
        await client.close()


def _announce(address: str, auth: AuthService, arguments: WebArguments) -> None:
    """Print the address of the page on standard output, and what is left to do by hand on standard error."""
    secret = (
        auth.setup_secret.issue() if auth.needs_setup else None
    )  # before the address: its reader may use it at once
    if arguments.address_output != "not":
        print(json.dumps({"page": address}) if arguments.address_output == "json" else address, flush=True)
    if secret is not None:
        _print_notice("auth.setup_secret", address=address, secret=secret, file=str(auth.setup_secret.path))
    if listen_host(arguments.web, auth) != arguments.web.host:
        _print_notice("auth.only_loopback", host=arguments.web.host)


def _print_notice(key: str, **params: str) -> None:
    print(i18n.text(key, i18n.preferred(), **params), file=sys.stderr, flush=True)


async def _stop_with_parent(server: HttpServer, parent: int) -> None:
    """Stop when the service has ended: its successor starts a web process at the same address."""
    while os.getppid() == parent:  # noqa: ASYNC110  the operating system reports no end of a parent
        await asyncio.sleep(_PARENT_CHECK_INTERVAL_S)
    server.stop()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
