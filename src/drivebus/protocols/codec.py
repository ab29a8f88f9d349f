"""Interface of a codec: encode and decode the frames of one protocol."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any, Protocol


class Effect(Enum):
    """What a frame does to the drive that obeys it, derived from its bytes."""

    NONE = "none"
    """A pure read."""
    SETTING = "setting"
    """Writes a parameter or a setpoint, resets a fault: no start by itself."""
    MOTION = "motion"
    """May start or jog the motor."""
    STOP = "stop"
    """Can only take motion away. Needs no permit, is dropped by no check (ruling 5)."""


@dataclass(frozen=True, slots=True)
class Incomplete:
    """Ask again when ``need`` bytes (counted from offset 0) have arrived."""

    need: int


@dataclass(frozen=True, slots=True)
class Complete:
    """The first ``size`` bytes are this message."""

    message: Any
    size: int


@dataclass(frozen=True, slots=True)
class CompleteIfSilent:
    """The first ``size`` bytes are this message if nothing follows; else ask again with ``need`` bytes (ruling 11)."""

    message: Any
    size: int
    need: int


DecodeResult = Incomplete | Complete | CompleteIfSilent


class Codec(Protocol):
    """One encoding of one protocol, both sides. Pure; strict at offset 0; never hunts.

    All decoding raises ``drivebus.errors.ProtocolError`` (a subclass) and nothing else, for any bytes, and gives
    the same answer whole or byte by byte.
    """

    family: str
    """"c320", "dzb100", "modbus"."""
    encoding: str
    """"ascii", "hex", "rtu"."""

    @property
    def broadcast_address(self) -> int | None:
        """The address that every station hears and none answers."""
        ...

    def encode_request(self, request: Any, /) -> bytes:
        """The canonical bytes of a request. Raises ValueError for a field out of range."""
        ...

    def encode_reply(self, reply: Any, /) -> bytes:
        """The canonical bytes of a station's reply."""
        ...

    def decode_request(self, data: bytes, /) -> DecodeResult:
        """Station side: the request that begins at offset 0."""
        ...

    def decode_reply(self, request: Any, data: bytes, /) -> DecodeResult:
        """Host side: is this the reply to that request? An error reply of the drive is a message, not an exception."""
        ...

    def reply_size(self, request: Any, /) -> int:
        """Bytes of the normal reply; 0 where none is expected (broadcast)."""
        ...

    def largest_reply(self, request: Any, /) -> int:
        """Bytes of the longest lawful reply: with this the reply deadline is computed."""
        ...

    def address_of(self, request: Any, /) -> int:
        """The station that the request speaks to."""
        ...
