"""Every codec that a campaign tries, in all its variants, each with its judge and with who makes lawful talk for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from random import Random
from typing import Any

from drivebus.protocols.codec import Codec
from drivebus.protocols.dzb100 import Dzb100Codec
from drivebus.protocols.modbus import ModbusAsciiCodec, ModbusRtuCodec
from drivebus.protocols.sunfar import SunfarCodec
from verification.codec_fuzz import exchanges
from verification.codec_fuzz.exchanges import LawfulExchange
from verification.reference.dzb100 import Dzb100Reference
from verification.reference.frame_shapes import FrameShape
from verification.reference.modbus import ModbusReference
from verification.reference.sunfar import SunfarReference

ReferenceCodec = SunfarReference | Dzb100Reference | ModbusReference


@dataclass(frozen=True, slots=True, eq=False)
class FuzzedCodec:
    """A codec under trial."""

    name: str
    codec: Codec
    reference: ReferenceCodec
    make_exchange: Callable[[Random, Codec], LawfulExchange]
    alphabet: bytes
    """What garbled bytes are drawn from: mostly what the codec's frames are made of."""
    longest: int
    """No frame of this codec has more bytes, whoever sent it: ``need`` may not ask for more (I12)."""
    interpret: Callable[[Any], None] = lambda reply: None
    """What is made of an accepted reply afterwards, in every coding; raises only what it says it does."""

    def exchange(self, rng: Random) -> LawfulExchange:
        """Lawful talk; now and then what is said to everybody, with the reply that nobody may give."""
        made = self.make_exchange(rng, self.codec)
        if rng.random() > BROADCAST_SHARE:
            return made
        try:
            request = exchanges.as_broadcast(made.request, self.codec)
            sent = self.codec.encode_request(request)
        except ValueError:  # a read
            return made
        at = self.reference.address
        received = made.received[: at.start] + sent[at] + made.received[at.stop :]
        return LawfulExchange(request, sent, self.reference.reseal(received))

    def request_of(self, sent: bytes) -> Any:
        """The request that these bytes are, as a host would have made it."""
        message = self.codec.decode_request(sent).message  # type: ignore[union-attr]
        return getattr(message, "request", message)

    def forms(self, sent: bytes) -> tuple[FrameShape, ...]:
        """All lawful replies to ``sent``, or (with nothing sent) all lawful requests."""
        return self.reference.shapes(sent) if sent else _request_forms(self)


@cache
def _request_forms(entry: FuzzedCodec) -> tuple[FrameShape, ...]:
    return entry.reference.shapes(b"")


BROADCAST_SHARE = 0.1
_HEX = b"0123456789ABCDEF"
_ALL = bytes(range(256))
_NIBBLES = bytes(range(16))
_RTU, _ASCII = 7 + 255 + 2, 2 * (7 + 255) + 5
"""The byte count of a garbled request may say 255."""


def _fuzzed_codecs() -> tuple[FuzzedCodec, ...]:
    loose = _HEX + b"abcdef:;<=>?"
    c320, modbus, df800 = exchanges.sunfar_exchange, exchanges.modbus_exchange, exchanges.df800_exchange
    return (
        FuzzedCodec("c320-ascii", SunfarCodec("ascii"), SunfarReference("ascii"), c320, _HEX, 18),
        FuzzedCodec(
            "c320-ascii-tolerant", SunfarCodec("ascii", "tolerant"), SunfarReference("ascii", True), c320, loose, 18
        ),
        FuzzedCodec("c320-hex", SunfarCodec("hex"), SunfarReference("hex"), c320, _NIBBLES, 18),
        FuzzedCodec(
            "c320-hex-nibble", SunfarCodec("hex", nibble=True), SunfarReference("hex", True), c320, _NIBBLES, 18
        ),
        FuzzedCodec(
            "dzb100",
            Dzb100Codec(),
            Dzb100Reference(),
            exchanges.dzb100_exchange,
            _HEX + b"\x06\x07",
            11,
            exchanges.dzb100_interpretations,
        ),
        FuzzedCodec("modbus-rtu", ModbusRtuCodec(), ModbusReference("rtu"), modbus, _ALL, _RTU),
        FuzzedCodec("modbus-ascii", ModbusAsciiCodec(), ModbusReference("ascii", marks=2), modbus, _HEX, _ASCII),
        FuzzedCodec(
            "modbus-ascii-resync",
            ModbusAsciiCodec(tolerate_leading_noise=True),
            ModbusReference("ascii", resync=4, marks=2),
            modbus,
            _HEX,
            _ASCII + 4,
        ),
        FuzzedCodec("df800-rtu", ModbusRtuCodec("short", 4), ModbusReference("rtu", short=True), df800, _ALL, _RTU),
        FuzzedCodec(
            "df800-ascii", ModbusAsciiCodec("short", 4), ModbusReference("ascii", True, marks=2), df800, _HEX, _ASCII
        ),
    )


FUZZED_CODECS = {entry.name: entry for entry in _fuzzed_codecs()}
