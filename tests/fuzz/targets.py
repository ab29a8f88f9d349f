"""The decoders that are fuzzed: every encoding of every family, with the requests of the worked frames."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from drivebus.errors import ProtocolError
from drivebus.protocols import dzb100, modbus, sunfar
from drivebus.protocols.codec import Codec, Complete
from drivebus.protocols.dzb100.codec import CONSTANT_S, HEADS
from drivebus.protocols.modbus.ascii import build_frame as ascii_seal
from drivebus.protocols.modbus.rtu import build_frame as rtu_seal
from drivebus.protocols.sunfar.codec import REQUEST_LAYOUTS
from drivebus.protocols.sunfar.frame import WRITE_LAYOUT
from drivebus.protocols.sunfar.messages import CLASS_OFFSET
from fixtures.vectors import load_vectors
from fuzz.harness import AtherisTarget

EXTRA_REQUESTS: dict[str, list[Any]] = {
    "modbus": [
        modbus.ReadBits(1, 0, 11),
        modbus.ReadRegisters(1, 0, 3, 4),
        modbus.WriteBit(1, 2, True),
        modbus.WriteBits(1, 2, (True,) * 9),
        modbus.WriteRegisters(1, 2, (1, 2)),
        modbus.Diagnostics(1, 0x5AA5),
        modbus.WriteRegister(1, 0x23, 0xA000),
        modbus.WriteRegister(0, 0x2000, 2),
    ],
    "sunfar": [
        sunfar.SunfarControl(1, sunfar.SunfarOperation.RUN_FORWARD_AT, 5000, expected_item=0),
        sunfar.SunfarWriteParameter(1, 0, 2, 0),
    ],
    "dzb100": [dzb100.Dzb100Query(1, item) for item in range(4)],
}
"""Requests that no manual has a frame for."""


def make_target(codec: Codec, family: str, encoding: str, seal: Callable[[bytes], bytes]) -> AtherisTarget:
    """A codec with the worked frames of a family's file."""
    found = [vector for vector in load_vectors(family) if vector.encoding == encoding]
    frames = [vector.data for vector in found]
    asked: list[Any] = []
    for vector in found:
        if vector.direction == "request" and (request := request_in(codec, vector.correct)) not in (None, *asked):
            asked.append(request)
    asked += EXTRA_REQUESTS[codec.family]
    return AtherisTarget(codec, asked, seal, [*frames, *(codec.encode_request(request) for request in asked)])


def request_in(codec: Codec, frame: bytes) -> Any:
    """The request that a frame is, None where it is none."""
    try:
        verdict = codec.decode_request(frame)
    except ProtocolError:
        return None
    if not isinstance(verdict, Complete):
        return None
    return verdict.message.request if isinstance(verdict.message, sunfar.ReceivedRequest) else verdict.message


def c320_ascii_seal(body: bytes) -> bytes:
    """Head, each byte's two digits cut to fit a frame, sum, end mark."""
    digits = body.hex().upper().encode()[:12]
    return b"*%b%04X\r" % (digits, sum(digits))


def c320_hex_seal(body: bytes) -> bytes:
    """As many bytes as the class says, without the bits that packed fields leave 0."""
    layout = REQUEST_LAYOUTS.get(body[CLASS_OFFSET - 1] & 0x0F if len(body) >= CLASS_OFFSET else 0, WRITE_LAYOUT)
    size = layout.size - len(b"Z....\r")
    number = int.from_bytes(body[:size].ljust(size, b"\0"), "big") & ~(layout.zero_mask >> 32)
    fields = number.to_bytes(size, "big")
    return b"Z%b%b\r" % (fields, sum(fields).to_bytes(4, "big"))


def dzb_seal(body: bytes) -> bytes:
    """There is no check to be right: a head, the constant, and digits where digits must be."""
    head = HEADS[body[0] % 4] if body else 0
    return bytes((head, CONSTANT_S)) + body[1:2] + body[2:6].hex().upper().encode()


ATHERIS_TARGETS: dict[str, AtherisTarget] = {
    "c320-ascii": make_target(sunfar.SunfarCodec("ascii"), "c320", "ascii", c320_ascii_seal),
    "c320-hex": make_target(sunfar.SunfarCodec("hex"), "c320", "hex", c320_hex_seal),
    "c320-tolerant": make_target(sunfar.SunfarCodec("ascii", "tolerant"), "c320", "ascii", c320_ascii_seal),
    "c320-nibble": make_target(sunfar.SunfarCodec("hex", nibble=True), "c320", "hex", c320_hex_seal),
    "dzb100": make_target(dzb100.Dzb100Codec(), "dzb100", "ascii", dzb_seal),
    "vc660": make_target(modbus.ModbusRtuCodec(max_read=4), "vc660", "rtu", rtu_seal),
    "df800-rtu": make_target(modbus.ModbusRtuCodec("short"), "df800", "rtu", rtu_seal),
    "df800-ascii": make_target(modbus.ModbusAsciiCodec("short"), "df800", "ascii", ascii_seal),
    "modbus-ascii-junk": make_target(
        modbus.ModbusAsciiCodec(tolerate_leading_noise=True), "df800", "ascii", ascii_seal
    ),
}
