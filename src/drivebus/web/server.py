"""The embedded uvicorn: where it listens, its limits, and how it ends (S14, S15)."""

from __future__ import annotations

import asyncio
import contextlib
import signal
import socket
import ssl
from collections.abc import Callable, Iterator

import uvicorn
from fastapi import FastAPI

from drivebus.errors import ConfigurationError
from drivebus.plant.access.access import Access
from drivebus.plant.loopback import is_loopback
from drivebus.plant.model import WebSetting
from drivebus.web.patience import Patience, PatientSocket

LOOPBACK = "127.0.0.1"
CONNECTIONS = 512
KEEP_ALIVE_S = 15
GRACE_S = 2
"""So long running requests may take when the process ends."""
WS_LARGEST = 64 * 1024
_LOOK_S = 0.5


def host_for(web: WebSetting, access: Access) -> str:
    """This machine only, unless there is TLS and an administrator (S15)."""
    if is_loopback(web.host) or (web.certificate is not None and not access.needs_setup):
        return web.host
    return LOOPBACK


class Server(uvicorn.Server):
    """uvicorn without its hands on the signals: it would raise SIGTERM again and skip every ``finally``."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield


class Listening:
    """Serves until it is told to stop; moves to the configured address once it may."""

    def __init__(self, app: FastAPI, access: Access, web: WebSetting, said: Callable[[str], None]) -> None:
        """``said`` gets the address, each time that there is a new one."""
        self.app = app
        self.access = access
        self.web = web
        self.said = said
        self._ending = asyncio.Event()

    def stop(self) -> None:
        self._ending.set()

    async def run(self) -> None:
        """Raises ConfigurationError where it can't listen there, or the certificate can't be used."""
        loop = asyncio.get_running_loop()
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, self.stop)
        while not self._ending.is_set():
            await self._serve(host_for(self.web, self.access))

    async def _serve(self, host: str) -> None:
        listener = bound(host, self.web.port)
        server = Server(config(self.app, self.web))
        scheme = "http" if self.web.certificate is None else "https"
        self.said(f"{scheme}://{_shown(host)}:{listener.getsockname()[1]}")
        serving = asyncio.create_task(server.serve([listener]))
        try:
            while not self._ending.is_set() and host == host_for(self.web, self.access) and not serving.done():
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(self._ending.wait(), _LOOK_S)
        finally:
            server.should_exit = True
            await serving


def config(app: FastAPI, web: WebSetting) -> uvicorn.Config:
    """Raises ConfigurationError for a certificate or key that can't be used."""
    made = uvicorn.Config(
        app,
        http=Patience,
        ws=PatientSocket,
        ws_max_size=WS_LARGEST,
        ws_per_message_deflate=False,
        lifespan="on",
        log_config=None,
        access_log=False,
        proxy_headers=False,
        server_header=False,
        limit_concurrency=CONNECTIONS,
        timeout_keep_alive=KEEP_ALIVE_S,
        timeout_graceful_shutdown=GRACE_S,
    )
    made.load()
    made.ssl = None if web.certificate is None else _tls(web)
    return made


def _tls(web: WebSetting) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        assert web.certificate is not None
        context.load_cert_chain(web.certificate, web.key)
    except (OSError, ssl.SSLError) as error:
        raise ConfigurationError("access.certificate", file=str(web.certificate), problem=str(error)) from error
    return context


def bound(host: str, port: int) -> socket.socket:
    """A listening socket. Raises ConfigurationError where the address is taken or not ours."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        listener = socket.socket(family, kind, protocol)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen()
    except OSError as error:
        raise ConfigurationError("access.can_not_listen", host=host, port=port, problem=str(error)) from error
    return listener


def _shown(host: str) -> str:
    return f"[{host}]" if ":" in host else host
