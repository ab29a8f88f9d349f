"""Requests and replies of Modbus as values, and the limits of their fields.

Source: Modbus Application Protocol V1.1b3, section 6; drive specifics: VC660 manual §5, DF800 manual.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final, NamedTuple

READ_FUNCTIONS: Final = frozenset((1, 2, 3, 4))
"""Functions that only read: 01 coils, 02 discrete inputs, 03 holding registers, 04 input registers."""
REGISTER_FUNCTIONS: Final = frozenset((3, 4))
ECHO_FUNCTIONS: Final = frozenset((5, 6, 8, 15, 16))
"""Functions whose reply is six octets and a check: the request or its first fields."""
FUNCTIONS: Final = READ_FUNCTIONS | ECHO_FUNCTIONS

BROADCAST: Final = 0
ADDRESSES: Final = range(1, 248)
"""Stations; 248-255 are reserved (Serial Line V1.02, 2.2)."""
MAX_READ: Final = 125
MAX_WRITE: Final = 123
"""Most registers of one request (V1.1b3, 6.3 and 6.12)."""
MAX_READ_BITS: Final = 2000
MAX_WRITE_BITS: Final = 1968
"""Most coils of one request (V1.1b3, 6.1 and 6.11)."""

ILLEGAL_FUNCTION: Final = 1
ILLEGAL_ADDRESS: Final = 2
ILLEGAL_VALUE: Final = 3
DEVICE_FAILURE: Final = 4
EXCEPTION_CODES: Final = frozenset((1, 2, 3, 4, 5, 6, 7, 8, 10, 11))
"""Codes of V1.1b3 section 7; VC660 documents 1 to 4."""
EXCEPTION_NAMES: Final = {
    ILLEGAL_FUNCTION: "illegal_function",
    ILLEGAL_ADDRESS: "illegal_address",
    ILLEGAL_VALUE: "illegal_value",
    DEVICE_FAILURE: "failed",
}
"""Exceptions that V1.1b3 section 7 and the VC660 manual define alike."""


class ReadRegisters(NamedTuple):
    """Read ``count`` registers from ``register``: function 03 (holding) or 04 (input).

    A named tuple, because the bus looks up each request's bytes: as a frozen dataclass it takes four times as long to
    make and find.
    """

    address: int
    register: int
    count: int = 1  # type: ignore[assignment]  # in place of the method of tuples
    function: int = 3


@dataclass(frozen=True, slots=True)
class ReadBits:
    """Read ``count`` bits from ``register``: function 01 (coils) or 02 (discrete inputs)."""

    address: int
    register: int
    count: int = 1
    function: int = 1


@dataclass(frozen=True, slots=True)
class WriteRegister:
    """Write one holding register (06)."""

    address: int
    register: int
    value: int
    function: ClassVar[int] = 6


@dataclass(frozen=True, slots=True)
class WriteRegisters:
    """Write consecutive holding registers (10H)."""

    address: int
    register: int
    values: tuple[int, ...]
    function: ClassVar[int] = 16


@dataclass(frozen=True, slots=True)
class WriteBit:
    """Write one coil (05)."""

    address: int
    register: int
    value: bool
    function: ClassVar[int] = 5


@dataclass(frozen=True, slots=True)
class WriteBits:
    """Write consecutive coils (0FH)."""

    address: int
    register: int
    values: tuple[bool, ...]
    function: ClassVar[int] = 15


@dataclass(frozen=True, slots=True)
class Diagnostics:
    """Diagnostics (08), sub-function 0000: the station returns ``data``, a 16-bit word."""

    address: int
    data: int
    function: ClassVar[int] = 8


ModbusRequest = ReadRegisters | ReadBits | WriteRegister | WriteRegisters | WriteBit | WriteBits | Diagnostics


@dataclass(slots=True)
class RegisterValues:
    """Reply to ``ReadRegisters``. Not frozen, which would take four times as long to make for each reply."""

    address: int
    function: int
    values: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class BitValues:
    """Reply to ``ReadBits``, with as many bits as requested."""

    address: int
    function: int
    values: tuple[bool, ...]


@dataclass(frozen=True, slots=True)
class WriteAck:
    """Reply to a write. ``value`` is the word (05: 0000H or FF00H) or, for 0FH and 10H, the count.

    It equals the first bytes of the request, so the echo of an adapter looks the same: it confirms nothing.
    """

    address: int
    function: int
    register: int
    value: int


@dataclass(frozen=True, slots=True)
class DiagnosticsReply:
    """Reply to ``Diagnostics``."""

    address: int
    data: int
    function: ClassVar[int] = 8


@dataclass(frozen=True, slots=True)
class ExceptionReply:
    """Rejection by the station: an exception code, or None for the short form of DF800, which gives no code."""

    address: int
    function: int
    """Function of the request, without the top bit."""
    code: int | None


ModbusReply = RegisterValues | BitValues | WriteAck | DiagnosticsReply | ExceptionReply
