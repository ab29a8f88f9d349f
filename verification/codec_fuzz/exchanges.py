"""Lawful talk by chance: a request, its bytes, and the bytes of one of the replies that it may get."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from random import Random
from typing import Any

from drivebus.errors import ProtocolError
from drivebus.protocols import dzb100 as d
from drivebus.protocols import modbus as m
from drivebus.protocols import sunfar as s
from drivebus.protocols.codec import Codec
from drivebus.protocols.dzb100.messages import FREQUENCY_CODINGS, FaultCoding

FAULT_CODINGS: tuple[FaultCoding, ...] = ("decimal", "hex")


@dataclass(frozen=True, slots=True)
class LawfulExchange:
    request: Any
    sent: bytes
    received: bytes


def sunfar_exchange(rng: Random, codec: Codec) -> LawfulExchange:
    """Any class, any response, a fault now and then."""
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
        return s.SunfarReply(request.address, response, state, group, info=f"{item:02X}{word:04X}")
    if isinstance(request, s.SunfarWriteParameter) and response is not s.SunfarResponse.OK:
        word = 0
    fault = rng.randrange(256) if state is s.SunfarState.FAULT else None
    return s.SunfarReply(request.address, response, state, group, item, word, fault)


def dzb100_exchange(rng: Random, codec: Codec) -> LawfulExchange:
    """Any head; done, refused, or for a command a state digit (T20)."""
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
    reply = d.Dzb100Reply(chr(request.head), address, request.index, data, accepted, digit)
    return LawfulExchange(request, sent, codec.encode_reply(reply))


def as_broadcast(request: Any, codec: Codec) -> Any:
    """The same request to all stations."""
    everyone = {"broadcast": True} if isinstance(request, d.Dzb100Control) else {}
    return replace(request, address=codec.broadcast_address, **everyone)


def dzb100_interpretations(reply: d.Dzb100Reply) -> None:
    """The word of a reply in all frequency codings (T08) and as a state: a number, or the error that is promised."""
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
    """Any function; counts mostly small, at times the largest."""
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
    """What a DF800 is asked: reads of 1 to 4 registers, writes of one; its short errors, and exceptions."""
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
