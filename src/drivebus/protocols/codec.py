"""Interface of a codec: encode and decode the frames of one protocol."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any, Protocol

from drivebus.errors import ProtocolError


class Effect(Enum):
    """Effect of a frame on the drive, derived from its bytes."""

    NONE = "none"
    """A pure read."""
    SETTING = "setting"
    """Writes a parameter or a setpoint, or resets a fault: does not start the motor by itself."""
    MOTION = "motion"
    """May start or jog the motor."""
    STOP = "stop"
    """Can only end motion. Needs no permit, is rejected by no check."""


@dataclass(frozen=True, slots=True)
class Incomplete:
    """More bytes are needed: decode again when there are ``need`` bytes, counted from offset 0."""

    need: int


@dataclass(slots=True)
class Complete:
    """The first ``size`` bytes are this message. Not frozen, which would take twice as long to make for each frame."""

    message: Any
    size: int


@dataclass(frozen=True, slots=True)
class CompleteIfSilent:
    """The first ``size`` bytes are this message if no byte follows; else decode again with ``need`` bytes."""

    message: Any
    size: int
    need: int


DecodedFrame = Complete | CompleteIfSilent
DecodeResult = Incomplete | DecodedFrame


class Codec(Protocol):
    """Encoding of a protocol, master and station side.

    Decoding depends on its arguments alone, so that its result may be cached: a frame begins at offset 0, nothing is
    searched, and the result is the same whole or byte by byte. It raises only subclasses of
    ``drivebus.errors.ProtocolError``, for any bytes.
    """

    family: str
    """Name of the ``ProtocolFamily``."""
    encoding: str
    """Name of the family's encoding, such as "ascii" or "rtu"."""

    def __hash__(self) -> int:
        """Return the hash of the codec, by identity unless it defines another."""
        ...

    @property
    def broadcast_address(self) -> int | None:
        """Address that every station obeys and none replies to; None where the protocol has none."""
        ...

    def encode_request(self, request: Any, /) -> bytes:
        """Return the canonical bytes of a request. Raises ValueError for a field out of range."""
        ...

    def encode_reply(self, reply: Any, /) -> bytes:
        """Return the canonical bytes of a reply. Raises ValueError for a field out of range."""
        ...

    def decode_request(self, data: bytes, /) -> DecodeResult:
        """Decode the request that begins at offset 0 (station side). Raises ProtocolError where none does."""
        ...

    def decode_reply(self, request: Any, data: bytes, /) -> DecodeResult:
        """Decode the reply to a request (master side); an error reply of the drive is a message.

        Raises ProtocolError where no such reply begins at offset 0.
        """
        ...

    def reply_size(self, request: Any, /) -> int:
        """Return the bytes of the normal reply; 0 where none is expected (broadcast)."""
        ...

    def largest_reply(self, request: Any, /) -> int:
        """Return the bytes of the longest permitted reply: the reply timeout is computed from it."""
        ...

    def address_of(self, request: Any, /) -> int:
        """Return the station that the request addresses."""
        ...


def check_range(name: str, value: int, low: int, high: int) -> int:
    """Return the value of a field. Raises ValueError, as ``encode_request`` does, outside the limits."""
    if not low <= value <= high:
        raise ValueError(f"{name} {value}: expected {low} to {high}")
    return value


def canonical_request(codec: Codec, frame: bytes) -> Any | None:
    """Return the request of which ``codec`` sends exactly these bytes, None where there is none."""
    try:
        result = codec.decode_request(frame)
        is_canonical = isinstance(result, Complete) and codec.encode_request(result.message) == frame
    except (ProtocolError, ValueError):
        return None
    return result.message if isinstance(result, Complete) and is_canonical else None
