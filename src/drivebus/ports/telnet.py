"""RFC 2217 (telnet COM-PORT option), client side, as bytes in and bytes out. Pure: no socket, no clock.

RFC 854/855: commands, negotiation, subnegotiation. RFC 856: binary. RFC 2217: serial settings and line state.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from drivebus.serial_settings import SerialSettings

SE, SB, WILL, WONT, DO, DONT, IAC = 240, 250, 251, 252, 253, 254, 255
BINARY, SUPPRESS_GO_AHEAD, COM_PORT = 0, 3, 44
SET_BAUDRATE, SET_DATASIZE, SET_PARITY, SET_STOPSIZE, SET_CONTROL = 1, 2, 3, 4, 5
NOTIFY_LINESTATE, SET_LINESTATE_MASK, SET_MODEMSTATE_MASK, PURGE_DATA = 6, 10, 11, 12
SERVER_REPLY_OFFSET = 100
"""The server's answers and notices carry the command's number plus 100 (RFC 2217 section 3)."""
PARITY = {"N": 1, "O": 2, "E": 3}
NO_FLOW_CONTROL = 1
PURGE_BOTH = 3
BAD_BYTE_MASK = 0x1E
"""Line state bits: overrun 2, parity error 4, framing error 8, break 16: each spoils a byte (G20)."""
MAX_SUBNEGOTIATION_BYTES = 256
"""A server's signature is the longest that is known; what follows is dropped, not kept in memory."""
SUPPORTED_OPTIONS = frozenset({BINARY, SUPPRESS_GO_AHEAD, COM_PORT})
"""Options that we do, and that the server may do. All others are declined, echo (1) above all."""

SETTINGS = {SET_BAUDRATE: "baud", SET_DATASIZE: "data bits", SET_PARITY: "parity", SET_STOPSIZE: "stop bits"}


@dataclass(frozen=True, slots=True)
class TelnetInput:
    """What a chunk from the server held."""

    data: bytes = b""
    line_errors: int = 0
    """Bytes that the server says were bad; it does not say which."""
    reply: bytes = b""
    """To be sent back at once."""


def subnegotiation(command: int, value: bytes) -> bytes:
    """One COM-PORT command."""
    return bytes((IAC, SB, COM_PORT, command)) + escape(value) + bytes((IAC, SE))


def escape(data: bytes) -> bytes:
    """Data as it goes over telnet: FF doubled."""
    return data.replace(b"\xff", b"\xff\xff")


def serial_commands(settings: SerialSettings) -> dict[int, bytes]:
    """The COM-PORT commands that set a line."""
    return {
        SET_BAUDRATE: struct.pack(">I", settings.baud),
        SET_DATASIZE: bytes((settings.data_bits,)),
        SET_PARITY: bytes((PARITY[settings.parity],)),
        SET_STOPSIZE: bytes((settings.stop_bits,)),
    }


class TelnetClient:
    """One session. ``accepted`` None until the server said whether it does COM-PORT."""

    def __init__(self) -> None:
        self.is_telnet = False
        """The server has sent a telnet command: it is no raw TCP server."""
        self.accepted: bool | None = None
        self.acknowledged: dict[int, bytes] = {}
        """Command → the value that the server says is in force."""
        self._local_options: dict[int, str] = {}
        self._remote_options: dict[int, str] = {}
        self._escape: list[int] = []
        self._sub: bytearray | None = None

    def start(self) -> bytes:
        """Our requests: both directions binary, no go-ahead, COM-PORT."""
        self._local_options = dict.fromkeys(SUPPORTED_OPTIONS, "asked")
        self._remote_options = dict.fromkeys((BINARY, SUPPRESS_GO_AHEAD), "asked")
        asked = [(WILL, COM_PORT), (WILL, BINARY), (DO, BINARY), (WILL, SUPPRESS_GO_AHEAD), (DO, SUPPRESS_GO_AHEAD)]
        return b"".join(bytes((IAC, verb, option)) for verb, option in asked)

    def configure(self, settings: SerialSettings) -> bytes:
        """Set the line, notices of bad bytes on, modem notices off, both buffers of the server emptied.

        RTS and DTR are not mentioned: they are left as they are (F09).
        """
        commands = serial_commands(settings) | {
            SET_CONTROL: bytes((NO_FLOW_CONTROL,)),
            SET_LINESTATE_MASK: bytes((BAD_BYTE_MASK,)),
            SET_MODEMSTATE_MASK: b"\x00",
            PURGE_DATA: bytes((PURGE_BOTH,)),
        }
        return b"".join(subnegotiation(command, value) for command, value in commands.items())

    def receive(self, chunk: bytes) -> TelnetInput:
        """Take the server's bytes in any portions."""
        if IAC not in chunk and not self._escape and self._sub is None:
            return TelnetInput(chunk)
        data, answer, marks = bytearray(), bytearray(), 0
        for byte in chunk:
            if self._escape:
                marks += self._command(byte, data, answer)
            elif byte == IAC:
                self._escape.append(byte)
            else:
                self._plain(byte, data)
        return TelnetInput(bytes(data), marks, bytes(answer))

    def _plain(self, byte: int, data: bytearray) -> None:
        if self._sub is None:
            data.append(byte)
        elif len(self._sub) < MAX_SUBNEGOTIATION_BYTES:
            self._sub.append(byte)

    def _command(self, byte: int, data: bytearray, answer: bytearray) -> int:
        """The byte after IAC, or the option after a verb. Gives the marks it brought."""
        escape, self._escape = self._escape, []
        if len(escape) == 2:
            answer += self._negotiate(escape[1], byte)
        elif byte == IAC:
            self._plain(byte, data)
        elif WILL <= byte <= DONT:
            self._escape = [IAC, byte]
        else:
            self.is_telnet = True
            sub, self._sub = self._sub, bytearray() if byte == SB else None
            if byte == SE and sub is not None:
                return self._handle_subnegotiation(bytes(sub))
        return 0

    def _negotiate(self, verb: int, option: int) -> bytes:
        """RFC 855: answer a change of state and nothing else, or both ends would answer for ever."""
        self.is_telnet = True
        states, yes, no = (self._local_options, WILL, WONT) if verb in (DO, DONT) else (self._remote_options, DO, DONT)
        state = states.get(option, "no")
        agreed = verb in (DO, WILL) and option in SUPPORTED_OPTIONS
        states[option] = "yes" if agreed else "no"
        if option == COM_PORT and verb != WONT:
            self.accepted = agreed
        if verb in (DO, WILL):
            reply = None if state != "no" else yes if agreed else no
        else:
            reply = no if state == "yes" else None
        return b"" if reply is None else bytes((IAC, reply, option))

    def _handle_subnegotiation(self, sub: bytes) -> int:
        """An answer or a notice of the COM-PORT option; anything else is none of ours."""
        if len(sub) < 3 or sub[0] != COM_PORT or sub[1] < SERVER_REPLY_OFFSET:
            return 0
        command, value = sub[1] - SERVER_REPLY_OFFSET, sub[2:]
        if command == NOTIFY_LINESTATE:
            return int(value[0] & BAD_BYTE_MASK != 0)
        self.acknowledged[command] = value
        return 0
