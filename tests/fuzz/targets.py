"""The decoders that are fuzzed: every encoding of every family, with the requests of the worked frames."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from drivebus.errors import ProtocolError
from drivebus.message import Codec, Complete
from drivebus.protocols import dzb, modbus, sifang
from drivebus.protocols.dzb.codec import HEADS, S
from drivebus.protocols.modbus.ascii import with_check as ascii_seal
from drivebus.protocols.modbus.rtu import with_check as rtu_seal
from drivebus.protocols.sifang.frame import WRITE
from drivebus.protocols.sifang.requests import REQUEST_LAYOUTS
from drivebus.protocols.sifang.tables import KIND_AT
from fuzz.harness import Target
from vectorfile import load

MORE: dict[str, list[Any]] = {
    "modbus": [
        modbus.ReadBits(1, 0, 11),
        modbus.ReadRegisters(1, 0, 3, 4),
        modbus.WriteBit(1, 2, True),
        modbus.WriteBits(1, 2, (True,) * 9),
        modbus.WriteRegisters(1, 2, (1, 2)),
        modbus.Loopback(1, 0x5AA5),
        modbus.WriteRegister(1, 0x23, 0xA000),
        modbus.WriteRegister(0, 0x2000, 2),
    ],
    "c320": [
        sifang.Control(1, sifang.Operation.RUN_FORWARD_AT, 5000, expected_item=0),
        sifang.WriteParameter(1, 0, 2, 0),
    ],
    "dzb100": [dzb.Query(1, item) for item in range(4)],
}
"""Requests that no manual has a frame for."""


def target(codec: Codec, family: str, encoding: str, seal: Callable[[bytes], bytes]) -> Target:
    """A codec with the worked frames of a family's file."""
    found = [vector for vector in load(family) if vector.encoding == encoding]
    frames = [vector.data for vector in found]
    asked: list[Any] = []
    for vector in found:
        if vector.direction == "request" and (request := heard(codec, vector.correct)) not in (None, *asked):
            asked.append(request)
    asked += MORE[codec.family]
    return Target(codec, asked, seal, [*frames, *(codec.encode_request(request) for request in asked)])


def heard(codec: Codec, frame: bytes) -> Any:
    """The request that a frame is, None where it is none."""
    try:
        verdict = codec.decode_request(frame)
    except ProtocolError:
        return None
    if not isinstance(verdict, Complete):
        return None
    return verdict.message.request if isinstance(verdict.message, sifang.Heard) else verdict.message


def c320_ascii_seal(body: bytes) -> bytes:
    """Head, each byte's two digits cut to fit a frame, sum, end mark."""
    digits = body.hex().upper().encode()[:12]
    return b"*%b%04X\r" % (digits, sum(digits))


def c320_hex_seal(body: bytes) -> bytes:
    """As many bytes as the class says, without the bits that packed fields leave 0."""
    layout = REQUEST_LAYOUTS.get(body[KIND_AT - 1] & 0x0F if len(body) >= KIND_AT else 0, WRITE)
    size = layout.size - len(b"Z....\r")
    number = int.from_bytes(body[:size].ljust(size, b"\0"), "big") & ~(layout.zeros >> 32)
    fields = number.to_bytes(size, "big")
    return b"Z%b%b\r" % (fields, sum(fields).to_bytes(4, "big"))


def dzb_seal(body: bytes) -> bytes:
    """There is no check to be right: a head, the constant, and digits where digits must be."""
    head = HEADS[body[0] % 4] if body else 0
    return bytes((head, S)) + body[1:2] + body[2:6].hex().upper().encode()


TARGETS: dict[str, Target] = {
    "c320-ascii": target(sifang.SifangCodec("ascii"), "c320", "ascii", c320_ascii_seal),
    "c320-hex": target(sifang.SifangCodec("hex"), "c320", "hex", c320_hex_seal),
    "c320-tolerant": target(sifang.SifangCodec("ascii", "tolerant"), "c320", "ascii", c320_ascii_seal),
    "c320-nibble": target(sifang.SifangCodec("hex", nibble=True), "c320", "hex", c320_hex_seal),
    "dzb100": target(dzb.DzbCodec(), "dzb100", "ascii", dzb_seal),
    "vc660": target(modbus.RtuCodec(max_read=4), "vc660", "rtu", rtu_seal),
    "df800-rtu": target(modbus.RtuCodec("short"), "df800", "rtu", rtu_seal),
    "df800-ascii": target(modbus.AsciiCodec("short"), "df800", "ascii", ascii_seal),
    "modbus-ascii-junk": target(modbus.AsciiCodec(resync=True), "df800", "ascii", ascii_seal),
}
