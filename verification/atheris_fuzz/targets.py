"""Fuzzed decoders: every encoding of every family, with the requests of its worked frames.

The first byte of an input selects the decoder (a request at a station, or the reply to one of the requests) and whether
the rest gets a correct check, without which few inputs would pass it. The contract is that of a ``Codec``: no error but
ProtocolError, the same result whole and byte by byte, correct ``need`` and ``size``.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivebus.errors import ProtocolError
from drivebus.protocols import dzb100, modbus, sunfar
from drivebus.protocols.codec import Codec, Complete, CompleteIfSilent, DecodeResult, Incomplete
from drivebus.protocols.dzb100.codec import CONSTANT_S, HEADS
from drivebus.protocols.modbus.ascii import build_frame as ascii_seal
from drivebus.protocols.modbus.rtu import build_frame as rtu_seal
from drivebus.protocols.sunfar.codec import REQUEST_LAYOUTS
from drivebus.protocols.sunfar.frame import WRITE_LAYOUT
from drivebus.protocols.sunfar.messages import CLASS_OFFSET

VECTORS_FOLDER = Path(__file__).resolve().parents[2] / "vectors"
MAX_INPUT_LENGTH = 300
"""Bytes of an input that are decoded; an input is fed byte by byte, so time grows with the square of its length."""
SEALED_CHOICE = 0x80
"""Bit of the first input byte: the frame gets a correct check."""
FuzzedDecoder = Callable[[bytes], DecodeResult]


class ContractViolation(AssertionError):
    """A decoder violates the contract of ``protocols.codec.Codec``."""


@dataclass(frozen=True, slots=True)
class AtherisTarget:
    """Encoding under test: codec, requests whose replies are decoded, and the function that adds a correct check."""

    codec: Codec
    requests: Sequence[Any]
    seal: Callable[[bytes], bytes]
    frames: Sequence[bytes]
    """Worked frames, from which the search starts."""

    def decoder(self, choice: int) -> FuzzedDecoder:
        """Return a decoder: 0 is the station's, the others are the master's, one for each request."""
        chosen = choice % (len(self.requests) + 1)
        if chosen == 0:
            return self.codec.decode_request
        request = self.requests[chosen - 1]
        return lambda data: self.codec.decode_reply(request, data)

    def run_input(self, data: bytes) -> None:
        """Decode one input. Raises ContractViolation, or any other error of the decoder."""
        if data:
            body = data[1 : MAX_INPUT_LENGTH + 1]
            check_decoder(self.decoder(data[0] & ~SEALED_CHOICE), self.seal(body) if data[0] & SEALED_CHOICE else body)

    def seeds(self) -> list[bytes]:
        """Return every worked frame for every decoder."""
        return [bytes((choice,)) + frame for choice in range(len(self.requests) + 1) for frame in self.frames]


def check_decoder(decode: FuzzedDecoder, data: bytes) -> None:
    """Raise ContractViolation unless the decoder keeps its contract for these bytes."""
    whole, need = _decode_outcome(decode, data), 1
    found: object = None
    for end in range(len(data) + 1):
        found = _decode_outcome(decode, data[:end])
        _check_sizes(found, data[:end], need)
        if not isinstance(found, Incomplete | CompleteIfSilent):
            break
        need = max(need, found.need)
    if found != whole:
        raise ContractViolation(f"{data.hex(' ')}: whole {whole}, byte by byte {found}")


def _decode_outcome(decode: FuzzedDecoder, data: bytes) -> object:
    try:
        return decode(data)
    except ProtocolError as error:
        if not 0 <= error.size <= len(data):
            raise ContractViolation(f"{data.hex(' ')}: size {error.size} of a rejected frame") from error
        str(error)
        return type(error), error.key, error.size


def _check_sizes(found: object, data: bytes, need: int) -> None:
    """Check the sizes of a result. ``need``: bytes that an earlier call required; with fewer no message is complete."""
    if isinstance(found, Complete | CompleteIfSilent) and not 0 < found.size <= len(data):
        raise ContractViolation(f"{data.hex(' ')}: {found} is longer than the data")
    if isinstance(found, Complete) and len(data) < need:
        raise ContractViolation(f"{data.hex(' ')}: complete, but {need} bytes were required")
    if isinstance(found, Incomplete | CompleteIfSilent) and found.need <= len(data):
        raise ContractViolation(f"{data.hex(' ')}: {found} requires no further byte")


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
"""Requests without a worked frame in any manual."""


def make_target(codec: Codec, model: str, encoding: str, seal: Callable[[bytes], bytes]) -> AtherisTarget:
    """Return a target with the worked frames of one model."""
    lines = (VECTORS_FOLDER / f"{model}.jsonl").read_text(encoding="utf-8").splitlines()
    vectors = [vector for vector in map(json.loads, lines) if vector["encoding"] == encoding]
    frames = [bytes.fromhex(vector["hex"]) for vector in vectors]
    requests: list[Any] = []
    for vector in vectors:
        if vector["direction"] == "request":
            request = decoded_request(codec, bytes.fromhex(vector.get("canonical_hex", vector["hex"])))
            if request not in (None, *requests):
                requests.append(request)
    requests += EXTRA_REQUESTS[codec.family]
    return AtherisTarget(codec, requests, seal, [*frames, *map(codec.encode_request, requests)])


def decoded_request(codec: Codec, frame: bytes) -> Any:
    """Return the request in a frame; None where it is no request."""
    try:
        verdict = codec.decode_request(frame)
    except ProtocolError:
        return None
    if not isinstance(verdict, Complete):
        return None
    return verdict.message.request if isinstance(verdict.message, sunfar.ReceivedRequest) else verdict.message


def c320_ascii_seal(body: bytes) -> bytes:
    """Return a frame with the digits of ``body``, cut to the longest frame, between head and sum."""
    digits = body.hex().upper().encode()[:12]
    return b"*%b%04X\r" % (digits, sum(digits))


def c320_hex_seal(body: bytes) -> bytes:
    """Return a frame of the length that its class requires, with the unused bits of packed fields cleared."""
    layout = REQUEST_LAYOUTS.get(body[CLASS_OFFSET - 1] & 0x0F if len(body) >= CLASS_OFFSET else 0, WRITE_LAYOUT)
    size = layout.size - len(b"Z....\r")
    number = int.from_bytes(body[:size].ljust(size, b"\0"), "big") & ~(layout.zero_mask >> 32)
    fields = number.to_bytes(size, "big")
    return b"Z%b%b\r" % (fields, sum(fields).to_bytes(4, "big"))


def dzb_seal(body: bytes) -> bytes:
    """Return a frame with a valid head, the constant S and hexadecimal digits; the protocol has no checksum."""
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
