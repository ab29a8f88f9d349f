"""Serial servers with RFC 2217 (telnet COM-PORT option): the serial settings travel with the connection.

``TelnetClient`` is the codec without socket and clock (RFC 854, 855: negotiation; RFC 856: binary; RFC 2217: serial
settings and line state), ``Rfc2217Port`` the port. A server that acknowledges another value than the one set is
rejected; where it acknowledges none, the port opens after ``NEGOTIATION_TIMEOUT_S`` and ``notes`` names the setting.
"""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Callable
from dataclasses import dataclass

from drivebus.errors import PortLost, PortUnavailable
from drivebus.ports.base import PortNote
from drivebus.ports.tcp import SerialServerPort, TcpConnection
from drivebus.ports.url import PortUrl
from drivebus.serial_settings import SerialSettings
from drivebus.types import Receiver

NEGOTIATION_TIMEOUT_S = 1.5  # for each of two steps, option and settings; servers reply within a round trip
SE, SB, WILL, WONT, DO, DONT, IAC = 240, 250, 251, 252, 253, 254, 255
BINARY, SUPPRESS_GO_AHEAD, COM_PORT = 0, 3, 44
SET_BAUDRATE, SET_DATASIZE, SET_PARITY, SET_STOPSIZE, SET_CONTROL = 1, 2, 3, 4, 5
NOTIFY_LINESTATE, SET_LINESTATE_MASK, SET_MODEMSTATE_MASK, PURGE_DATA = 6, 10, 11, 12
SERVER_REPLY_OFFSET = 100  # a reply or notice has the command's number plus 100 (RFC 2217 section 3)
PARITY = {"N": 1, "O": 2, "E": 3}
NO_FLOW_CONTROL = 1
PURGE_BOTH = 3
BAD_BYTE_MASK = 0x1E  # line state: overrun 2, parity error 4, framing error 8, break 16; each damages a byte
MAX_SUBNEGOTIATION_BYTES = 256  # bytes beyond it are dropped; the longest known, a signature, is shorter
SUPPORTED_OPTIONS = frozenset({BINARY, SUPPRESS_GO_AHEAD, COM_PORT})  # in both directions; all others are declined

SETTING_NAMES = {SET_BAUDRATE: "baud", SET_DATASIZE: "data bits", SET_PARITY: "parity", SET_STOPSIZE: "stop bits"}


@dataclass(frozen=True, slots=True)
class TelnetInput:
    """Content of a chunk from the server."""

    data: bytes = b""
    line_errors: int = 0
    """Bad bytes that the server reports; it does not report which."""
    reply: bytes = b""
    """Bytes to send back at once."""


def subnegotiation(command: int, value: bytes) -> bytes:
    """Return the bytes of one COM-PORT command."""
    return bytes((IAC, SB, COM_PORT, command)) + escape(value) + bytes((IAC, SE))


def escape(data: bytes) -> bytes:
    """Return data as telnet transmits it: FF doubled."""
    return data.replace(b"\xff", b"\xff\xff")


def serial_commands(settings: SerialSettings) -> dict[int, bytes]:
    """Return the COM-PORT commands that set the serial format, with their values."""
    return {
        SET_BAUDRATE: struct.pack(">I", settings.baud),
        SET_DATASIZE: bytes((settings.data_bits,)),
        SET_PARITY: bytes((PARITY[settings.parity],)),
        SET_STOPSIZE: bytes((settings.stop_bits,)),
    }


class TelnetClient:
    """Client side of one session. ``accepted``: None until the server has replied to the COM-PORT option."""

    def __init__(self) -> None:
        self.is_telnet = False
        """The server has sent a telnet command: it is no raw TCP server."""
        self.accepted: bool | None = None
        self.acknowledged: dict[int, bytes] = {}
        """Command → the value that the server reports as in force."""
        self._local_options: dict[int, str] = {}
        self._remote_options: dict[int, str] = {}
        self._escape: list[int] = []
        self._sub: bytearray | None = None

    def start(self) -> bytes:
        """Return our requests: both directions binary, no go-ahead, COM-PORT."""
        self._local_options = dict.fromkeys(SUPPORTED_OPTIONS, "requested")
        self._remote_options = dict.fromkeys((BINARY, SUPPRESS_GO_AHEAD), "requested")
        requests = [(WILL, COM_PORT), (WILL, BINARY), (DO, BINARY), (WILL, SUPPRESS_GO_AHEAD), (DO, SUPPRESS_GO_AHEAD)]
        return b"".join(bytes((IAC, verb, option)) for verb, option in requests)

    def configure(self, settings: SerialSettings) -> bytes:
        """Return the commands: serial format, notices of bad bytes on, modem notices off, both server buffers emptied.

        RTS and DTR stay as they are.
        """
        commands = serial_commands(settings) | {
            SET_CONTROL: bytes((NO_FLOW_CONTROL,)),
            SET_LINESTATE_MASK: bytes((BAD_BYTE_MASK,)),
            SET_MODEMSTATE_MASK: b"\x00",
            PURGE_DATA: bytes((PURGE_BOTH,)),
        }
        return b"".join(subnegotiation(command, value) for command, value in commands.items())

    def receive(self, chunk: bytes) -> TelnetInput:
        """Decode bytes of the server, in any portions."""
        if IAC not in chunk and not self._escape and self._sub is None:
            return TelnetInput(chunk)
        data, reply, line_errors = bytearray(), bytearray(), 0
        for byte in chunk:
            if self._escape:
                line_errors += self._handle_command(byte, data, reply)
            elif byte == IAC:
                self._escape.append(byte)
            else:
                self._add_byte(byte, data)
        return TelnetInput(data=bytes(data), line_errors=line_errors, reply=bytes(reply))

    def _add_byte(self, byte: int, data: bytearray) -> None:
        if self._sub is None:
            data.append(byte)
        elif len(self._sub) < MAX_SUBNEGOTIATION_BYTES:
            self._sub.append(byte)

    def _handle_command(self, byte: int, data: bytearray, reply: bytearray) -> int:
        """Handle the byte after IAC, or the option after a verb; return the bad bytes that it reports."""
        escape, self._escape = self._escape, []
        if len(escape) == 2:
            reply += self._negotiate(escape[1], byte)
        elif byte == IAC:
            self._add_byte(byte, data)
        elif WILL <= byte <= DONT:
            self._escape = [IAC, byte]
        else:
            self.is_telnet = True
            sub, self._sub = self._sub, bytearray() if byte == SB else None
            if byte == SE and sub is not None:
                return self._handle_subnegotiation(bytes(sub))
        return 0

    def _negotiate(self, verb: int, option: int) -> bytes:
        """Return the reply to a change of state, empty for anything else: both ends would reply for ever (RFC 855)."""
        self.is_telnet = True
        states, yes, no = (self._local_options, WILL, WONT) if verb in (DO, DONT) else (self._remote_options, DO, DONT)
        state = states.get(option, "no")
        agreed = verb in (DO, WILL) and option in SUPPORTED_OPTIONS
        states[option] = "yes" if agreed else "no"
        if option == COM_PORT and verb != WONT:
            self.accepted = agreed
        if verb in (DO, WILL):
            answer = None if state != "no" else yes if agreed else no
        else:
            answer = no if state == "yes" else None
        return b"" if answer is None else bytes((IAC, answer, option))

    def _handle_subnegotiation(self, sub: bytes) -> int:
        """Handle a reply or notice of the COM-PORT option; return the bad bytes that it reports."""
        if len(sub) < 3 or sub[0] != COM_PORT or sub[1] < SERVER_REPLY_OFFSET:
            return 0
        command, value = sub[1] - SERVER_REPLY_OFFSET, sub[2:]
        if command == NOTIFY_LINESTATE:
            return int(value[0] & BAD_BYTE_MASK != 0)
        self.acknowledged[command] = value
        return 0


class Rfc2217Port(SerialServerPort):
    """Port of a serial server with RFC 2217: ``rfc2217://HOST:PORT?baud=…&format=…&timeout=3``."""

    def __init__(self, url: PortUrl) -> None:
        """Raises PortUrlError for an unknown option."""
        super().__init__(url)
        self.notes: tuple[PortNote, ...] = ()
        """Settings that the server did not acknowledge."""
        self._telnet = TelnetClient()
        self._receiver: Receiver | None = None
        self._server_replied = asyncio.Event()
        self._failure: PortLost | None = None

    async def open(self, receiver: Receiver) -> None:
        """Connect, negotiate, set the serial format. Raises PortUnavailable with the reason and the remedy."""
        if self._connection is not None:
            raise PortUnavailable("ports.already_open", port=self._name)
        self._telnet, self._failure = TelnetClient(), None
        connection = TcpConnection(self._name, self._on_data, self._on_lost)
        await connection.connect(self._host, self._port, self._timeout_s)
        self._connection = connection
        try:
            await self._negotiate(connection)
        except PortLost as error:
            await self.close()
            raise PortUnavailable("ports.net", port=self._name, reason=error.params.get("reason", "")) from error
        except BaseException:
            await self.close()
            raise
        self._receiver = receiver

    def write(self, data: bytes, /) -> None:
        """Raises PortLost; the receiver gets ``port_lost`` once, later."""
        if self._connection is None or self._receiver is None:
            raise PortLost("ports.not_open", port=self._name)
        self._connection.write(escape(data))

    async def close(self) -> None:
        connection, self._connection = self._connection, None
        self._receiver = None
        if connection is not None:
            connection.close()

    async def _negotiate(self, connection: TcpConnection) -> None:
        connection.write(self._telnet.start())
        await self._wait_until(lambda: self._telnet.accepted is not None)
        if self._telnet.accepted is False:
            raise PortUnavailable("ports.rfc2217_refused", port=self._name, host=self._host, number=self._port)
        if not self._telnet.is_telnet:
            raise PortUnavailable("ports.rfc2217_silent", port=self._name, host=self._host, number=self._port)
        commands = serial_commands(self.settings)
        connection.write(self._telnet.configure(self.settings))
        await self._wait_until(lambda: {*commands, PURGE_DATA} <= self._telnet.acknowledged.keys())
        self.notes = self._compare(commands)

    def _compare(self, commands: dict[int, bytes]) -> tuple[PortNote, ...]:
        """Note the settings not acknowledged. Raises PortUnavailable for one acknowledged with another value."""
        missing = []
        for command, value in commands.items():
            name, acknowledged = SETTING_NAMES[command], self._telnet.acknowledged.get(command)
            if acknowledged is None:
                missing.append(name)
            elif acknowledged != value:
                raise PortUnavailable(
                    "ports.rfc2217_value",
                    port=self._name,
                    name=name,
                    expected=int.from_bytes(value),
                    found=int.from_bytes(acknowledged),
                )
        return (PortNote("ports.rfc2217_unacknowledged", {"names": tuple(missing)}),) if missing else ()

    async def _wait_until(self, is_done: Callable[[], bool]) -> None:
        """Wait until ``is_done`` or the timeout. Raises PortLost where the connection is lost."""
        try:
            async with asyncio.timeout(NEGOTIATION_TIMEOUT_S):
                while not is_done() and self._failure is None:
                    self._server_replied.clear()
                    await self._server_replied.wait()
        except TimeoutError:
            return
        if self._failure is not None:
            raise self._failure

    def _on_data(self, chunk: bytes) -> None:
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

    def _on_lost(self, error: PortLost) -> None:
        self._failure = error
        self._server_replied.set()
        self._connection = None
        receiver, self._receiver = self._receiver, None
        if receiver is not None:
            receiver.port_lost(error)


def open_port(url: PortUrl) -> Rfc2217Port:
    """Return the port of a URL ``rfc2217://``. Raises PortUrlError."""
    return Rfc2217Port(url)
