"""``python -m drivebus.web SOCKET [SETTING]``: the web process. The plant starts it, and outlives it."""

from __future__ import annotations

import asyncio
import json
import os
import sys
from contextlib import suppress

from drivebus import i18n
from drivebus.errors import ConfigurationError
from drivebus.plant.access.access import Access
from drivebus.plant.access.child import Child, understood
from drivebus.plant.precedence import PEOPLE, give_way, seldom_collect
from drivebus.plant.socket_client import SocketClient
from drivebus.web.app import make_app
from drivebus.web.server import Listening, host_for

_LOOK_S = 1.0


def main(arguments: list[str]) -> int:
    """Exit code 2 where the arguments, the address or the certificate can't be used."""
    give_way(PEOPLE)
    try:
        socket, child = understood(arguments)
        asyncio.run(_run(SocketClient(socket), child))
    except ConfigurationError as error:
        print(error.text(i18n.preferred()), file=sys.stderr, flush=True)
        return 2
    except ValueError as error:
        print(f"python -m drivebus.web: {error}", file=sys.stderr, flush=True)
        return 2
    return 0


async def _run(client: SocketClient, child: Child) -> None:
    access = Access(child.directory, child.users)
    listening = Listening(make_app(client, access, child.web), access, child.web, lambda at: _say(at, access, child))
    seldom_collect()
    orphaned = asyncio.create_task(_stop_with_parent(listening, child.parent))
    try:
        await listening.run()
    finally:
        orphaned.cancel()
        with suppress(asyncio.CancelledError):
            await orphaned
        await client.close()


def _say(at: str, access: Access, child: Child) -> None:
    """Where the page is, on standard output; on standard error what somebody has to do by hand."""
    secret = access.setup.offer() if access.needs_setup else None  # before the address: whoever reads that may use it
    if child.announce != "not":
        print(json.dumps({"page": at}) if child.announce == "json" else at, flush=True)
    if secret is not None:
        _note("access.setup_secret", address=at, secret=secret, file=str(access.setup.path))
    if host_for(child.web, access) != child.web.host:
        _note("access.only_loopback", host=child.web.host)


def _note(key: str, **params: str) -> None:
    print(i18n.text(key, i18n.preferred(), **params), file=sys.stderr, flush=True)


async def _stop_with_parent(listening: Listening, parent: int) -> None:
    """The plant is gone: its successor starts a web process of its own, at the same address."""
    while os.getppid() == parent:  # noqa: ASYNC110  the system tells nobody of a parent's end
        await asyncio.sleep(_LOOK_S)
    listening.stop()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
