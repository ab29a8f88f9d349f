"""Serial servers with RFC 2217: the serial settings travel with the connection. The protocol itself is in ``telnet``.

A server that never acknowledges a setting does not block the opening: after ``NEGOTIATION_TIMEOUT_S`` the port opens
and ``notes`` names what was not acknowledged. A server that acknowledges another value is refused.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from drivebus.errors import PortLost, PortUnavailable
from drivebus.ports import telnet
from drivebus.ports.base import PortNote
from drivebus.ports.tcp import CONNECT_TIMEOUT_S, TcpConnection
from drivebus.ports.url import PortUrl
from drivebus.types import Capabilities, EchoSetting, Receiver

NEGOTIATION_TIMEOUT_S = 1.5  # for each of two steps, option and settings; servers reply within a round trip


class Rfc2217Port:
    """``rfc2217://HOST:PORT?baud=…&format=…&timeout=3``."""

    def __init__(self, url: PortUrl) -> None:
        """Raises PortUrlError for an unknown option."""
        url.reject_unknown_options("echo", "timeout")
        self.settings = url.settings
        self.capabilities = Capabilities()
        self.echo: EchoSetting = url.echo()
        self.url = url.text
        self.identity = f"rfc2217:{url.host}:{url.port}"
        self.notes: tuple[PortNote, ...] = ()
        """What the server did not acknowledge."""
        self._host, self._port = url.host, url.port or 0
        self._timeout_s = url.number("timeout", CONNECT_TIMEOUT_S, 0.1, 60)
        self._connection: TcpConnection | None = None
        self._telnet = telnet.TelnetClient()
        self._receiver: Receiver | None = None
        self._server_replied = asyncio.Event()
        self._failure: PortLost | None = None

    async def open(self, receiver: Receiver) -> None:
        """Connect, negotiate, set the serial format. Raises PortUnavailable with the reason and the remedy."""
        if self._connection is not None:
            raise PortUnavailable("ports.already-open", port=self.identity)
        self._telnet, self._failure = telnet.TelnetClient(), None
        connection = TcpConnection(self.identity, self._received, self._lost)
        await connection.connect(self._host, self._port, self._timeout_s)
        self._connection = connection
        try:
            await self._negotiate(connection)
        except PortLost as error:
            await self.close()
            raise PortUnavailable("ports.net", port=self.identity, reason=error.params.get("reason", "")) from error
        except BaseException:
            await self.close()
            raise
        self._receiver = receiver

    def write(self, data: bytes, /) -> None:
        """Raises PortLost; the receiver gets ``port_lost`` once, later."""
        if self._connection is None or self._receiver is None:
            raise PortLost("ports.not-open", port=self.identity)
        self._connection.write(telnet.escape(data))

    async def close(self) -> None:
        connection, self._connection = self._connection, None
        self._receiver = None
        if connection is not None:
            connection.close()

    async def _negotiate(self, connection: TcpConnection) -> None:
        connection.write(self._telnet.start())
        await self._wait_until(lambda: self._telnet.accepted is not None)
        if self._telnet.accepted is False:
            raise PortUnavailable("ports.rfc2217-refused", port=self.identity, host=self._host, number=self._port)
        if not self._telnet.is_telnet:
            raise PortUnavailable("ports.rfc2217-silent", port=self.identity, host=self._host, number=self._port)
        commands = telnet.serial_commands(self.settings)
        connection.write(self._telnet.configure(self.settings))
        await self._wait_until(lambda: {*commands, telnet.PURGE_DATA} <= self._telnet.acknowledged.keys())
        self.notes = self._compare(commands)

    def _compare(self, commands: dict[int, bytes]) -> tuple[PortNote, ...]:
        """Note the settings not acknowledged. Raises PortUnavailable for one acknowledged with another value."""
        missing = []
        for command, value in commands.items():
            name, found = telnet.SETTINGS[command], self._telnet.acknowledged.get(command)
            if found is None:
                missing.append(name)
            elif found != value:
                raise PortUnavailable(
                    "ports.rfc2217-value",
                    port=self.identity,
                    name=name,
                    expected=int.from_bytes(value),
                    found=int.from_bytes(found),
                )
        return (PortNote("ports.rfc2217-unacknowledged", {"names": ", ".join(missing)}),) if missing else ()

    async def _wait_until(self, done: Callable[[], bool]) -> None:
        """Wait until ``done`` or the timeout. Raises PortLost where the connection is lost."""
        try:
            async with asyncio.timeout(NEGOTIATION_TIMEOUT_S):
                while not done() and self._failure is None:
                    self._server_replied.clear()
                    await self._server_replied.wait()
        except TimeoutError:
            return
        if self._failure is not None:
            raise self._failure

    def _received(self, chunk: bytes) -> None:
        decoded = self._telnet.receive(chunk)
        if decoded.reply and self._connection is not None:
            try:
                self._connection.write(decoded.reply)
            except PortLost:
                return  # the transport reports the loss itself
        if self._receiver is None:
            self._server_replied.set()
        elif decoded.data or decoded.line_errors:
            self._receiver.data_received(decoded.data, decoded.line_errors)

    def _lost(self, error: PortLost) -> None:
        self._failure = error
        self._server_replied.set()
        self._connection = None
        receiver, self._receiver = self._receiver, None
        if receiver is not None:
            receiver.port_lost(error)


def open_port(url: PortUrl) -> Rfc2217Port:
    """Entry point of scheme ``rfc2217``. Raises PortUrlError."""
    return Rfc2217Port(url)
