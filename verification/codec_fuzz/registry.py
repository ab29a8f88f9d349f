"""Registry of the fuzzed codecs: every variant with its reference codec and a generator of valid exchanges."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from random import Random
from typing import Any

from drivebus.errors import ProtocolError
from drivebus.protocols import dzb100 as d
from drivebus.protocols import modbus as m
from drivebus.protocols import sunfar as s
from drivebus.protocols.codec import Codec
from drivebus.protocols.dzb100 import Dzb100Codec
from drivebus.protocols.dzb100.messages import FREQUENCY_CODINGS, FaultCoding
from drivebus.protocols.modbus import ModbusAsciiCodec, ModbusRtuCodec
from drivebus.protocols.sunfar import SunfarCodec
from verification.reference.dzb100 import Dzb100Reference
from verification.reference.frame_shapes import FrameShape
from verification.reference.modbus import ModbusReference
from verification.reference.sunfar import SunfarReference

# --- valid exchanges --------------------------------------------------------------------------------------------------

FAULT_CODINGS: tuple[FaultCoding, ...] = ("decimal", "hex")


@dataclass(frozen=True, slots=True)
class LawfulExchange:
    request: Any
    sent: bytes
    received: bytes


def sunfar_exchange(rng: Random, codec: Codec) -> LawfulExchange:
    """Return an exchange of any class and response, at times with a fault."""
    address, group, item, word = rng.randrange(31), rng.randrange(16), rng.randrange(256), rng.getrandbits(16)
    operation = rng.choice(list(s.SunfarOperation))
    request = rng.choice(
        (
            s.ReadIdentity(address, group),
            s.ReadMonitor(address, item),
            s.SunfarReadParameter(address, group, item),
            s.SunfarWriteParameter(address, group, item, word, save=word % 2 == 1),
            s.SunfarControl(address, operation, word if operation.sets_frequency else 0, expected_item=item),
        )
    )
    return LawfulExchange(
        request, codec.encode_request(request), codec.encode_reply(_sunfar_reply(rng, request, item, word))
    )


def _sunfar_reply(rng: Random, request: Any, item: int, word: int) -> s.SunfarReply:
    response, state = rng.choice((s.SunfarResponse.OK, *s.SunfarResponse)), rng.choice(list(s.SunfarState))
    group = 0 if isinstance(request, s.ReadMonitor | s.SunfarControl) else request.group
    if isinstance(request, s.ReadIdentity):
        return s.SunfarReply(
            address=request.address, response=response, state=state, group=group, info=f"{item:02X}{word:04X}"
        )
    if isinstance(request, s.SunfarWriteParameter) and response is not s.SunfarResponse.OK:
        word = 0
    fault = rng.randrange(256) if state is s.SunfarState.FAULT else None
    return s.SunfarReply(
        address=request.address, response=response, state=state, group=group, item=item, data=word, fault_code=fault
    )


def dzb100_exchange(rng: Random, codec: Codec) -> LawfulExchange:
    """Return an exchange of any head: accepted, rejected, or a command with a state digit (T20)."""
    address, parameter, word = rng.randint(1, 31), rng.randint(0, 80), rng.getrandbits(16)
    command = rng.choice([each for each in d.Dzb100Command if each is not d.Dzb100Command.RESET])
    choices = (
        d.Dzb100Control(address, command, word),
        d.Dzb100WriteParameter(address, parameter, word),
        d.Dzb100ReadParameter(address, parameter),
        d.Dzb100Query(address, rng.randint(0, 3)),
    )
    request = rng.choice(choices)
    sent = codec.encode_request(request)
    accepted = rng.choice((True, True, False, None)) if isinstance(request, d.Dzb100Control) else rng.random() < 0.8
    reads = isinstance(request, d.Dzb100ReadParameter | d.Dzb100Query) or accepted is False
    data = rng.getrandbits(16) if reads else int(sent[7:], 16)
    digit = None if accepted is not None else rng.randint(0, 8)
    reply = d.Dzb100Reply(
        head=chr(request.head), address=address, index=request.index, data=data, accepted=accepted, digit=digit
    )
    return LawfulExchange(request, sent, codec.encode_reply(reply))


def as_broadcast(request: Any, codec: Codec) -> Any:
    """Return the same request as a broadcast."""
    everyone = {"broadcast": True} if isinstance(request, d.Dzb100Control) else {}
    return replace(request, address=codec.broadcast_address, **everyone)


def dzb100_interpretations(reply: d.Dzb100Reply) -> None:
    """Interpret the word of a reply in all frequency codings (T08) and as a state; raise where a result does not encode
    back."""
    for coding in FREQUENCY_CODINGS:
        with suppress(ValueError):
            hz = d.decode_frequency(reply.data, coding)
            if d.encode_frequency(hz, coding) != reply.data:
                raise AssertionError(f"{coding}: {reply.data:04X} reads {hz} Hz, which is written otherwise")
    for fault_coding in FAULT_CODINGS:
        with suppress(ProtocolError):
            if d.StateWord.parse(reply.data, fault_coding).encode(fault_coding) != reply.data:
                raise AssertionError(f"{fault_coding}: state {reply.data:04X} is written otherwise")


def modbus_exchange(rng: Random, codec: Codec) -> LawfulExchange:
    """Return an exchange of any function, mostly with small counts."""
    count = rng.choice((1, 1, 2, 3, 4, rng.randint(1, 20), rng.randint(1, 123)))
    address, register, word = rng.randint(1, 247), rng.randrange(0xFE00), rng.getrandbits(16)
    request = rng.choice(
        (
            m.ReadRegisters(address, register, count, rng.choice((3, 4))),
            m.ReadBits(address, register, count, rng.choice((1, 2))),
            m.WriteRegister(address, register, word),
            m.WriteRegisters(address, register, tuple(rng.getrandbits(16) for _ in range(count))),
            m.WriteBit(address, register, word % 2 == 1),
            m.WriteBits(address, register, tuple(rng.random() < 0.5 for _ in range(count))),
            m.Diagnostics(address, word),
        )
    )
    code = rng.choice((1, 2, 3, 4, 5, 6, 7, 8, 10, 11)) if rng.random() < 0.2 else 0
    return _modbus_reply(rng, codec, request, code)


def df800_exchange(rng: Random, codec: Codec) -> LawfulExchange:
    """Return an exchange of a DF800: reads of 1 to 4 registers, writes of one, short errors and exceptions."""
    address, register, word = (
        rng.randint(1, 247),
        rng.choice((rng.randrange(2048), 0x2000, 0x2001)),
        rng.getrandbits(16),
    )
    request = rng.choice(
        (m.ReadRegisters(address, register, rng.randint(1, 4)), m.WriteRegister(address, register, word))
    )
    if rng.random() < 0.05:  # The one write whose echo begins like its error
        request = m.WriteRegister(1, 0x0023, 0xA000 + rng.randrange(256))
    return _modbus_reply(rng, codec, request, rng.choice((0, 0, 0, None, 2)))


def _modbus_reply(rng: Random, codec: Codec, request: Any, code: int | None) -> LawfulExchange:
    address, function = request.address, request.function
    reply: m.ModbusReply
    if code != 0:
        reply = m.ExceptionReply(address, function, code)
    elif isinstance(request, m.ReadRegisters):
        reply = m.RegisterValues(address, function, tuple(rng.getrandbits(16) for _ in range(request.count)))
    elif isinstance(request, m.ReadBits):
        reply = m.BitValues(address, function, tuple(rng.random() < 0.5 for _ in range(request.count)))
    elif isinstance(request, m.Diagnostics):
        reply = m.DiagnosticsReply(address, request.data)
    else:
        reply = m.WriteAck(address, function, request.register, _is_write(request))
    return LawfulExchange(request, codec.encode_request(request), codec.encode_reply(reply))


def _is_write(request: Any) -> int:
    if isinstance(request, m.WriteBit):
        return 0xFF00 if request.value else 0
    return request.value if isinstance(request, m.WriteRegister) else len(request.values)


# --- codecs -----------------------------------------------------------------------------------------------------------

ReferenceCodec = SunfarReference | Dzb100Reference | ModbusReference


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FuzzedCodec:
    """Codec to fuzz."""

    name: str
    codec: Codec
    reference: ReferenceCodec
    make_exchange: Callable[[Random, Codec], LawfulExchange]
    alphabet: bytes
    """Bytes from which garbled bytes are drawn."""
    longest: int
    """Longest frame of this codec, in bytes; ``need`` may not exceed it (I12)."""
    interpret: Callable[[Any], None] = lambda reply: None
    """Interpretation of an accepted reply in every coding."""

    def exchange(self, rng: Random) -> LawfulExchange:
        """Return a valid exchange, at times a broadcast with a reply, which is never valid."""
        made = self.make_exchange(rng, self.codec)
        if rng.random() > BROADCAST_SHARE:
            return made
        try:
            request = as_broadcast(made.request, self.codec)
            sent = self.codec.encode_request(request)
        except ValueError:  # a read
            return made
        at = self.reference.address
        received = made.received[: at.start] + sent[at] + made.received[at.stop :]
        return LawfulExchange(request, sent, self.reference.reseal(received))

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


BROADCAST_SHARE = 0.1
_HEX = b"0123456789ABCDEF"
_ALL = bytes(range(256))
_NIBBLES = bytes(range(16))
_RTU, _ASCII = 7 + 255 + 2, 2 * (7 + 255) + 5
"""Longest frames: the byte count of a garbled request may be 255."""


def _fuzzed_codecs() -> tuple[FuzzedCodec, ...]:
    loose = _HEX + b"abcdef:;<=>?"
    c320, modbus, df800 = sunfar_exchange, modbus_exchange, df800_exchange
    return (
        FuzzedCodec(
            name="c320-ascii",
            codec=SunfarCodec("ascii"),
            reference=SunfarReference("ascii"),
            make_exchange=c320,
            alphabet=_HEX,
            longest=18,
        ),
        FuzzedCodec(
            name="c320-ascii-tolerant",
            codec=SunfarCodec("ascii", "tolerant"),
            reference=SunfarReference("ascii", True),
            make_exchange=c320,
            alphabet=loose,
            longest=18,
        ),
        FuzzedCodec(
            name="c320-hex",
            codec=SunfarCodec("hex"),
            reference=SunfarReference("hex"),
            make_exchange=c320,
            alphabet=_NIBBLES,
            longest=18,
        ),
        FuzzedCodec(
            name="c320-hex-nibble",
            codec=SunfarCodec("hex", nibble=True),
            reference=SunfarReference("hex", True),
            make_exchange=c320,
            alphabet=_NIBBLES,
            longest=18,
        ),
        FuzzedCodec(
            name="dzb100",
            codec=Dzb100Codec(),
            reference=Dzb100Reference(),
            make_exchange=dzb100_exchange,
            alphabet=_HEX + b"\x06\x07",
            longest=11,
            interpret=dzb100_interpretations,
        ),
        FuzzedCodec(
            name="modbus-rtu",
            codec=ModbusRtuCodec(),
            reference=ModbusReference("rtu"),
            make_exchange=modbus,
            alphabet=_ALL,
            longest=_RTU,
        ),
        FuzzedCodec(
            name="modbus-ascii",
            codec=ModbusAsciiCodec(),
            reference=ModbusReference("ascii", marks=2),
            make_exchange=modbus,
            alphabet=_HEX,
            longest=_ASCII,
        ),
        FuzzedCodec(
            name="modbus-ascii-resync",
            codec=ModbusAsciiCodec(tolerate_leading_noise=True),
            reference=ModbusReference("ascii", resync=4, marks=2),
            make_exchange=modbus,
            alphabet=_HEX,
            longest=_ASCII + 4,
        ),
        FuzzedCodec(
            name="df800-rtu",
            codec=ModbusRtuCodec("short", 4),
            reference=ModbusReference("rtu", short=True),
            make_exchange=df800,
            alphabet=_ALL,
            longest=_RTU,
        ),
        FuzzedCodec(
            name="df800-ascii",
            codec=ModbusAsciiCodec("short", 4),
            reference=ModbusReference("ascii", True, marks=2),
            make_exchange=df800,
            alphabet=_HEX,
            longest=_ASCII,
        ),
    )


FUZZED_CODECS = {entry.name: entry for entry in _fuzzed_codecs()}
