"""The octets that others send and expect: fastcrc for the CRC, pymodbus for PDU and framing."""

from __future__ import annotations

import random
from typing import Any

import pytest

from drivebus.protocols.checksum import crc16
from drivebus.protocols.modbus import (
    BitValues,
    Diagnostics,
    ExceptionReply,
    ModbusAsciiCodec,
    ModbusRtuCodec,
    ReadBits,
    ReadRegisters,
    RegisterValues,
    WriteAck,
    WriteBit,
    WriteBits,
    WriteRegister,
    WriteRegisters,
)
from peers import need_module


def test_the_crc_is_fastcrcs() -> None:
    need_module("fastcrc")
    from fastcrc import crc16 as fast

    rng = random.Random(1)
    for size in range(300):
        data = rng.randbytes(size)
        assert crc16(data) == fast.modbus(data)


@pytest.fixture
def pdu() -> Any:
    need_module("pymodbus")
    import pymodbus.pdu as module

    return module


def framer(encoding: str, station: bool) -> Any:
    from pymodbus.framer import FramerAscii, FramerRTU
    from pymodbus.pdu import DecodePDU

    return (FramerRTU if encoding == "rtu" else FramerAscii)(DecodePDU(station))


def pairs() -> list[tuple[Any, Any]]:
    """Our request and pymodbus' own of the same meaning."""
    from pymodbus.pdu import bit_message as bit
    from pymodbus.pdu import register_message as register
    from pymodbus.pdu.diag_message import ReturnQueryDataRequest

    return [
        (ReadRegisters(7, 0x3000, 4), register.ReadHoldingRegistersRequest(address=0x3000, count=4, dev_id=7)),
        (ReadRegisters(7, 9, 2, 4), register.ReadInputRegistersRequest(address=9, count=2, dev_id=7)),
        (ReadBits(7, 19, 19), bit.ReadCoilsRequest(address=19, count=19, dev_id=7)),
        (ReadBits(7, 19, 8, 2), bit.ReadDiscreteInputsRequest(address=19, count=8, dev_id=7)),
        (WriteRegister(7, 0x2000, 2), register.WriteSingleRegisterRequest(address=0x2000, registers=[2], dev_id=7)),
        (WriteBit(7, 172, True), bit.WriteSingleCoilRequest(address=172, bits=[True], dev_id=7)),
        (
            WriteRegisters(7, 1, (10, 258)),
            register.WriteMultipleRegistersRequest(address=1, registers=[10, 258], dev_id=7),
        ),
        (
            WriteBits(7, 19, (True, False, True) * 4),
            bit.WriteMultipleCoilsRequest(address=19, bits=[True, False, True] * 4, dev_id=7),
        ),
        (Diagnostics(7, 0x5AA5), ReturnQueryDataRequest(b"\x5a\xa5", dev_id=7)),
    ]


@pytest.mark.parametrize("codec", [ModbusRtuCodec(), ModbusAsciiCodec()], ids=["rtu", "ascii"])
def test_our_requests_are_pymodbus_requests(pdu: Any, codec: ModbusRtuCodec | ModbusAsciiCodec) -> None:
    for ours, theirs in pairs():
        sent = framer(codec.encoding, station=False).buildFrame(theirs)
        assert codec.encode_request(ours) == sent
        assert codec.decode_request(sent).message == ours
        _, received = framer(codec.encoding, station=True).handleFrame(codec.encode_request(ours), 0, 0)
        assert type(received) is type(theirs)
        assert (received.dev_id, received.encode()) == (7, theirs.encode())


@pytest.mark.parametrize("codec", [ModbusRtuCodec(), ModbusAsciiCodec()], ids=["rtu", "ascii"])
def test_our_replies_are_pymodbus_replies(pdu: Any, codec: ModbusRtuCodec | ModbusAsciiCodec) -> None:
    from pymodbus.pdu import ExceptionResponse
    from pymodbus.pdu import bit_message as bit
    from pymodbus.pdu import register_message as register

    rows = [
        (
            ReadRegisters(7, 0, 3),
            RegisterValues(7, 3, (1, 2, 0xFFFF)),
            register.ReadHoldingRegistersResponse(registers=[1, 2, 0xFFFF], dev_id=7),
        ),
        (
            ReadBits(7, 0, 8),
            BitValues(7, 1, (True, False) * 4),
            bit.ReadCoilsResponse(bits=[True, False] * 4, dev_id=7),
        ),
        (
            WriteRegister(7, 0x2000, 2),
            WriteAck(7, 6, 0x2000, 2),
            register.WriteSingleRegisterResponse(address=0x2000, registers=[2], dev_id=7),
        ),
        (
            WriteRegisters(7, 1, (10, 258)),
            WriteAck(7, 16, 1, 2),
            register.WriteMultipleRegistersResponse(address=1, count=2, dev_id=7),
        ),
        (ReadRegisters(7, 0, 3), ExceptionReply(7, 3, 2), ExceptionResponse(3, 2, device_id=7)),
    ]
    for request, ours, theirs in rows:
        sent = framer(codec.encoding, station=True).buildFrame(theirs)
        assert codec.encode_reply(ours) == sent
        assert codec.decode_reply(request, sent).message == ours
        _, received = framer(codec.encoding, station=False).handleFrame(codec.encode_reply(ours), 7, 0)
        assert (received.dev_id, received.function_code) == (7, theirs.function_code)
