"""``HttpServer``: uvicorn inside this process, with its address, its limits and its end."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import ssl
from collections.abc import Callable, Iterator

import uvicorn
from fastapi import FastAPI

from drivebus.errors import ConfigurationError
from drivebus.service.auth.service import AuthService
from drivebus.service.config.loopback import is_loopback
from drivebus.web.gateway import WebConfig
from drivebus.web.middleware.connection_limits import LimitedHttpProtocol, LimitedWebSocketProtocol

LOOPBACK = "127.0.0.1"
MAX_CONNECTIONS = 512
KEEP_ALIVE_TIMEOUT_S = 15
SHUTDOWN_GRACE_S = 2  # for requests under way when the process ends
MAX_WEBSOCKET_MESSAGE_BYTES = 64 * 1024
_HOST_CHECK_INTERVAL_S = 0.5


def listen_host(web: WebConfig, auth: AuthService) -> str:
    """Return the configured host only with TLS and an administrator, else this machine's own."""
    if is_loopback(web.host) or (web.certificate is not None and not auth.needs_setup):
        return web.host
    return LOOPBACK


class EmbeddedServer(uvicorn.Server):
    """uvicorn without its signal handlers, which would raise SIGTERM again and skip every ``finally``."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield


class HttpServer:
    """Serves until ``ending`` is set; moves to the configured address once it may listen there."""

    def __init__(
        self, app: FastAPI, auth: AuthService, web: WebConfig, on_address: Callable[[str], None], ending: asyncio.Event
    ) -> None:
        """``on_address`` gets each new address as a URL."""
        self.app = app
        self.auth = auth
        self.web = web
        self.on_address = on_address
        self._ending = ending

    async def run(self) -> None:
        """Raises ConfigurationError for an address or certificate that cannot be used."""
        while not self._ending.is_set():
            await self._serve(listen_host(self.web, self.auth))

    async def _serve(self, host: str) -> None:
        listener = bind_listener(host, self.web.port)
        server = EmbeddedServer(server_config(self.app, self.web))
        scheme = "http" if self.web.certificate is None else "https"
        self.on_address(f"{scheme}://{_url_host(host)}:{listener.getsockname()[1]}")
        serving = asyncio.create_task(server.serve([listener]))
        try:
            while not self._ending.is_set() and host == listen_host(self.web, self.auth) and not serving.done():
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(self._ending.wait(), _HOST_CHECK_INTERVAL_S)
        finally:
            server.should_exit = True
            await serving


def server_config(app: FastAPI, web: WebConfig) -> uvicorn.Config:
    """Raises ConfigurationError for a certificate or key that cannot be used."""
    config = uvicorn.Config(
        app,
        http=LimitedHttpProtocol,
        ws=LimitedWebSocketProtocol,
        ws_max_size=MAX_WEBSOCKET_MESSAGE_BYTES,
        ws_per_message_deflate=False,
        lifespan="on",
        log_config=None,
        access_log=False,
        proxy_headers=False,
        server_header=False,
        limit_concurrency=MAX_CONNECTIONS,
        timeout_keep_alive=KEEP_ALIVE_TIMEOUT_S,
        timeout_graceful_shutdown=SHUTDOWN_GRACE_S,
    )
    config.load()
    config.ssl = None if web.certificate is None else _tls_context(web)
    return config


def _tls_context(web: WebConfig) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        assert web.certificate is not None
        context.load_cert_chain(web.certificate, web.key)
    except (OSError, ssl.SSLError) as error:
        raise ConfigurationError("auth.certificate", file=str(web.certificate), problem=str(error)) from error
    return context


def bind_listener(host: str, port: int) -> socket.socket:
    """Return a listening socket. Raises ConfigurationError for an address that is in use or not of this machine."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        listener = socket.socket(family, kind, protocol)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen()
    except OSError as error:
        raise ConfigurationError("auth.can_not_listen", host=host, port=port, problem=str(error)) from error
    return listener


def _url_host(host: str) -> str:
    return f"[{host}]" if ":" in host else host
