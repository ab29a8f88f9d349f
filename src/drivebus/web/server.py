"""``HttpServer``: uvicorn inside this process, with its address, its limits and its end."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import ssl
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import uvicorn
from fastapi import FastAPI
from starlette.types import ASGIApp

from drivebus import i18n
from drivebus.errors import ConfigurationError, SystemReason
from drivebus.service.auth.service import AuthService
from drivebus.service.config.loopback import is_loopback
from drivebus.web.gateway import WebConfig, url_host
from drivebus.web.listener import (
    MAX_CONNECTIONS,
    MAX_CONNECTIONS_PER_ADDRESS,
    OVERLOAD_CONNECTIONS,
    BoundedListener,
)
from drivebus.web.middleware.connection_limits import LimitedHttpProtocol, LimitedWebSocketProtocol
from drivebus.web.middleware.trusted_proxies import TrustedProxies
from drivebus.web.tls import TlsContext

LOG = logging.getLogger(__name__)
LOOPBACK = "127.0.0.1"
KEEP_ALIVE_TIMEOUT_S = 15
TLS_HANDSHAKE_TIMEOUT_S = 10.0  # as for the headers of a request
TLS_SHUTDOWN_TIMEOUT_S = 2.0  # a client that does not answer the end of TLS
SHUTDOWN_GRACE_S = 2  # for requests under way when the process ends
MAX_WEBSOCKET_MESSAGE_BYTES = 64 * 1024
CLOSED_REPORT_INTERVAL_S = 60.0  # of the log line about connections beyond the limits: a flood does not fill the log
_CHECK_INTERVAL_S = 0.5  # of the address, the certificate and the limits


def listen_host(web: WebConfig, auth: AuthService) -> str:
    """Return the configured host only with TLS and an administrator, else this machine's own.

    Where the users are missing nothing can be set up, and the page says what is missing.
    """
    is_set_up = not auth.needs_setup or auth.users_missing
    if is_loopback(web.host) or (web.certificate is not None and is_set_up):
        return web.host
    return LOOPBACK


class EmbeddedServer(uvicorn.Server):
    """Server of uvicorn without its signal handlers, which would raise SIGTERM again and skip every ``finally``.

    It limits the time of a TLS handshake, which uvicorn leaves at a minute.
    """

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Listen at ``sockets``. Raises RuntimeError where the app does not start."""
        await self.lifespan.startup()
        if self.lifespan.should_exit:
            raise RuntimeError("the app does not start")
        tls = self.config.ssl is not None
        self.servers = [
            await asyncio.get_running_loop().create_server(
                self._create_protocol,
                sock=listener,
                ssl=self.config.ssl,
                backlog=self.config.backlog,
                ssl_handshake_timeout=TLS_HANDSHAKE_TIMEOUT_S if tls else None,
                ssl_shutdown_timeout=TLS_SHUTDOWN_TIMEOUT_S if tls else None,
            )
            for listener in sockets or ()
        ]
        self.started = True

    def _create_protocol(self) -> asyncio.Protocol:
        create: Any = self.config.http_protocol_class
        protocol: asyncio.Protocol = create(
            config=self.config, server_state=self.server_state, app_state=self.lifespan.state
        )
        return protocol

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
        self._tls: TlsContext | None = None

    def reload_certificate(self) -> None:
        """Read the certificate and its key again, whether or not their files look changed."""
        if self._tls is not None:
            self._tls.load()

    async def run(self) -> None:
        """Serve until the end. Raises ConfigurationError for an address or certificate that cannot be used."""
        while not self._ending.is_set():
            await self._serve(listen_host(self.web, self.auth))

    async def _serve(self, host: str) -> None:
        listener = bind_listener(host, self.web.port, self.web.trusted_proxies)
        tls = self._tls = None if self.web.certificate is None else TlsContext(self.web)
        server = EmbeddedServer(server_config(self.app, None if tls is None else tls.context))
        scheme = "http" if self.web.certificate is None else "https"
        self.on_address(f"{scheme}://{url_host(host)}:{listener.getsockname()[1]}")
        closed = ClosedConnectionsLog(listener)
        serving = asyncio.create_task(server.serve([listener]))
        try:
            while not self._ending.is_set() and host == listen_host(self.web, self.auth) and not serving.done():
                if not self.auth.needs_setup:
                    self.auth.setup_secret.consume()  # an administrator may have been added on the command line
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(self._ending.wait(), _CHECK_INTERVAL_S)
                if tls is not None:
                    tls.follow_files()
                closed.report(asyncio.get_running_loop().time())
        finally:
            if self._ending.is_set():
                self.app.state.live.close("shutdown")
            server.should_exit = True
            await serving


class ClosedConnectionsLog:
    """Log of the connections that a listener closes beyond its limits, at most one line a minute."""

    def __init__(self, listener: BoundedListener) -> None:
        self._listener = listener
        self._reported_count = 0
        self._reported_at = -CLOSED_REPORT_INTERVAL_S

    def report(self, now: float) -> None:
        """Log the connections that were closed since the last line. ``now``: monotonic seconds."""
        count = self._listener.closed_count
        if count == self._reported_count or now - self._reported_at < CLOSED_REPORT_INTERVAL_S:
            return
        text = i18n.preferred_text(
            "log.connections_closed",
            count=count - self._reported_count,
            open=self._listener.open_count,
            most=MAX_CONNECTIONS + OVERLOAD_CONNECTIONS,
            most_of_address=MAX_CONNECTIONS_PER_ADDRESS,
        )
        LOG.warning(text)
        self._reported_count, self._reported_at = count, now


def server_config(app: ASGIApp, context: ssl.SSLContext | None = None) -> uvicorn.Config:
    """Return the settings of uvicorn."""
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
    config.ssl = context
    return config


def bind_listener(host: str, port: int, trusted_proxies: Iterable[str] = ()) -> BoundedListener:
    """Return a listening socket. Raises ConfigurationError for an address that is in use or not of this machine."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        proxies = TrustedProxies(trusted_proxies)
        listener = BoundedListener(family, kind, protocol, is_proxy=proxies.trusts_peer)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen()
    except (OSError, UnicodeError) as error:
        raise ConfigurationError("auth.can_not_listen", host=host, port=port, problem=SystemReason(error)) from error
    return listener
