"""Program of a chosen user that opens a serial port: it holds the port, or tries to open it N times.

    user_process.py USER EXCLUSIVE hold|N PATH

USER is the number that it changes to after all its modules are loaded (the interpreter may lie where only root may
read). EXCLUSIVE 1: the pty counts as a real port, so that TIOCEXCL is set too.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import sys

from drivebus.errors import PortUnavailable
from drivebus.ports import discovery, open_port, tty


class IgnoringReceiver:
    def data_received(self, data: bytes, marks: int = 0) -> None: ...

    def port_lost(self, error: Exception) -> None: ...


async def attempt(path: str) -> dict[str, object]:
    port = open_port(path)
    try:
        await port.open(IgnoringReceiver())
    except PortUnavailable as error:
        return {"key": error.key, "pid": error.params.get("pid"), "text": str(error)}
    await port.close()
    return {"key": "opened"}


async def hold(path: str) -> None:
    await open_port(path).open(IgnoringReceiver())
    print("open", flush=True)
    await asyncio.sleep(600)


async def load_modules() -> None:
    """Load every module that is loaded on first use, without making a folder that this user would own."""
    home = os.environ["XDG_STATE_HOME"]
    os.environ["XDG_STATE_HOME"] = "/dev/null"
    discovery.discover_ports()
    with contextlib.suppress(PortUnavailable):
        await open_port("/dev/null").open(IgnoringReceiver())
    os.environ["XDG_STATE_HOME"] = home


async def main() -> None:
    user, exclusive, what, path = int(sys.argv[1]), sys.argv[2] == "1", sys.argv[3], sys.argv[4]
    await load_modules()
    if exclusive:
        tty.is_pty = lambda _: False
        tty._refuse_if_in_use = lambda *_: None  # the pty's far end holds it open too
    if os.getuid() == 0:
        os.setgroups([])
        os.setgid(user)
        os.setuid(user)
    if what == "hold":
        await hold(path)
    for _ in range(int(what)):
        print(json.dumps(await attempt(path)), flush=True)


asyncio.run(main())
