"""``python -m drivebus.web SOCKET [SETTING]``: the web process. The plant starts it, and outlives it."""

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
    """Exit code 2 where the arguments, the address or the certificate can't be used."""
    set_nice(NICE_WEB)
    try:
        socket, child = parse_web_arguments(arguments)
        asyncio.run(_run(SocketClient(socket), child))
    except ConfigurationError as error:
        print(error.text(i18n.preferred()), file=sys.stderr, flush=True)
        return 2
    except ValueError as error:
        print(f"python -m drivebus.web: {error}", file=sys.stderr, flush=True)
        return 2
    return 0


async def _run(client: SocketClient, child: WebArguments) -> None:
    access = AuthService(child.directory, child.user_file)
    listening = HttpServer(
        make_app(client, access, child.web), access, child.web, lambda at: _announce(at, access, child)
    )
    relax_gc()
    orphaned = asyncio.create_task(_stop_with_parent(listening, child.parent_pid))
    try:
        await listening.run()
    finally:
        orphaned.cancel()
        with suppress(asyncio.CancelledError):
            await orphaned
        await client.close()


def _announce(at: str, access: AuthService, child: WebArguments) -> None:
    """Where the page is, on standard output; on standard error what somebody has to do by hand."""
    secret = (
        access.setup_secret.issue() if access.needs_setup else None
    )  # before the address: whoever reads that may use it
    if child.address_output != "not":
        print(json.dumps({"page": at}) if child.address_output == "json" else at, flush=True)
    if secret is not None:
        _print_notice("auth.setup_secret", address=at, secret=secret, file=str(access.setup_secret.path))
    if listen_host(child.web, access) != child.web.host:
        _print_notice("auth.only_loopback", host=child.web.host)


def _print_notice(key: str, **params: str) -> None:
    print(i18n.text(key, i18n.preferred(), **params), file=sys.stderr, flush=True)


async def _stop_with_parent(listening: HttpServer, parent: int) -> None:
    """The plant is gone: its successor starts a web process of its own, at the same address."""
    while os.getppid() == parent:  # noqa: ASYNC110  the system tells nobody of a parent's end
        await asyncio.sleep(_PARENT_CHECK_INTERVAL_S)
    listening.stop()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
