"""Codec under test with its reference codec and a generator of valid exchanges."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from random import Random
from typing import Any, Protocol

from drivebus.protocols.codec import Codec
from verification.reference.frame_shapes import FrameShape

BROADCAST_SHARE = 0.1
HEX_DIGITS = b"0123456789ABCDEF"
ALL_BYTES = bytes(range(256))


@dataclass(frozen=True, slots=True)
class ValidExchange:
    request: Any
    sent: bytes
    received: bytes


class ReferenceCodec(Protocol):
    """Codec written a second time from the documents."""

    @property
    def marks(self) -> int: ...

    @property
    def address(self) -> slice: ...

    def accepted_size(self, sent: bytes, received: bytes) -> int | None: ...

    def is_well_formed(self, frame: bytes) -> bool: ...

    def reseal(self, frame: bytes) -> bytes: ...

    def shapes(self, sent: bytes) -> tuple[FrameShape, ...]: ...


def address_broadcast(request: Any, codec: Codec) -> Any:
    """Return the request with the broadcast address."""
    change = getattr(request, "_replace", None) or partial(replace, request)  # a read of registers is a named tuple
    return change(address=codec.broadcast_address)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FuzzedCodec:
    """Codec to fuzz, with its reference and the means to make valid exchanges."""

    name: str
    codec: Codec
    reference: ReferenceCodec
    make_exchange: Callable[[Random, Codec], ValidExchange]
    alphabet: bytes
    """Bytes from which garbled bytes are drawn."""
    longest: int
    """Longest frame of this codec, in bytes; ``need`` may not exceed it (I12)."""
    interpret: Callable[[Any], None] = lambda reply: None
    """Interpretation of an accepted reply in every coding."""
    broadcast_of: Callable[[Any, Codec], Any] = address_broadcast
    """The same request as a broadcast."""

    def exchange(self, rng: Random) -> ValidExchange:
        """Return a valid exchange, at times a broadcast with a reply, which is never valid."""
        made = self.make_exchange(rng, self.codec)
        if rng.random() > BROADCAST_SHARE or self.codec.broadcast_address is None:
            return made
        try:
            request = self.broadcast_of(made.request, self.codec)
            sent = self.codec.encode_request(request)
        except ValueError:  # a read
            return made
        at = self.reference.address
        received = made.received[: at.start] + sent[at] + made.received[at.stop :]
        return ValidExchange(request, sent, self.reference.reseal(received))

    def request_of(self, sent: bytes) -> Any:
        """Return the request of these bytes as a master would build it."""
        message = self.codec.decode_request(sent).message  # type: ignore[union-attr]
        return getattr(message, "request", message)

    def forms(self, sent: bytes) -> tuple[FrameShape, ...]:
        """Return the shapes of all valid replies to ``sent``, or of all valid requests."""
        return self.reference.shapes(sent) if sent else _request_forms(self)


@cache
def _request_forms(entry: FuzzedCodec) -> tuple[FrameShape, ...]:
    return entry.reference.shapes(b"")
