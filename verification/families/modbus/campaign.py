"""VC660, DF800 and plain Modbus for the campaigns: exchanges, codecs and frames."""

from __future__ import annotations

from functools import partial
from random import Random
from typing import Any

from drivebus.protocols import modbus as m
from drivebus.protocols.codec import Codec
from drivebus.protocols.modbus import ModbusAsciiCodec, ModbusRtuCodec
from verification.codec_fuzz.fuzzed_codec import ALL_BYTES, HEX_DIGITS, FuzzedCodec, ValidExchange
from verification.drive_variants import DriveVariant
from verification.families.family_campaign import FamilyCampaign, StrengthCase, WrittenParameter
from verification.families.modbus.matrix import MATRIX
from verification.families.modbus.station import ModbusStation
from verification.reference.modbus import ModbusReference

LONGEST_RTU, LONGEST_ASCII = 7 + 255 + 2, 2 * (7 + 255) + 5
"""Longest frames: the byte count of a garbled request may be 255."""


def modbus_exchange(rng: Random, codec: Codec) -> ValidExchange:
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


def df800_exchange(rng: Random, codec: Codec) -> ValidExchange:
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


def rejected_read_exchange(rng: Random, codec: Codec) -> ValidExchange:
    """Return an exchange with a drive that reads one register at a time and rejects reads of two (Toshiba VF-S11)."""
    address, register, count = rng.randint(1, 247), rng.randrange(0xFE00), rng.choice((1, 1, 2))
    code = 3 if count == 2 else rng.choice((0, 0, 0, 1, 2, 4))
    request = rng.choice(
        (m.ReadRegisters(address, register, count), m.WriteRegister(address, register, rng.getrandbits(16)))
    )
    return _modbus_reply(rng, codec, request, code)


def _modbus_reply(rng: Random, codec: Codec, request: Any, code: int | None) -> ValidExchange:
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
        reply = m.WriteAck(address, function, request.register, _acknowledged_value(request))
    return ValidExchange(request, codec.encode_request(request), codec.encode_reply(reply))


def _acknowledged_value(request: Any) -> int:
    if isinstance(request, m.WriteBit):
        return 0xFF00 if request.value else 0
    return request.value if isinstance(request, m.WriteRegister) else len(request.values)


def similar_reads(variant: DriveVariant, address: int) -> tuple[Any, ...]:
    """Return reads of one register."""
    registers = (0x3002, 0x3003, 0x300B) if variant.model == "vc660" else (0, 3, 5, 6)
    return tuple(m.ReadRegisters(address, register, 1) for register in registers)


CAMPAIGN = FamilyCampaign(
    fuzzed_codecs=(
        FuzzedCodec(
            name="modbus-rtu",
            codec=ModbusRtuCodec(),
            reference=ModbusReference("rtu"),
            make_exchange=modbus_exchange,
            alphabet=ALL_BYTES,
            longest=LONGEST_RTU,
        ),
        FuzzedCodec(
            name="modbus-ascii",
            codec=ModbusAsciiCodec(),
            reference=ModbusReference("ascii", marks=2),
            make_exchange=modbus_exchange,
            alphabet=HEX_DIGITS,
            longest=LONGEST_ASCII,
        ),
        FuzzedCodec(
            name="modbus-ascii-resync",
            codec=ModbusAsciiCodec(tolerate_leading_noise=True),
            reference=ModbusReference("ascii", resync=4, marks=2),
            make_exchange=modbus_exchange,
            alphabet=HEX_DIGITS,
            longest=LONGEST_ASCII + 4,
        ),
        FuzzedCodec(
            name="df800-rtu",
            codec=ModbusRtuCodec("short", 4),
            reference=ModbusReference("rtu", short=True),
            make_exchange=df800_exchange,
            alphabet=ALL_BYTES,
            longest=LONGEST_RTU,
        ),
        FuzzedCodec(
            name="df800-ascii",
            codec=ModbusAsciiCodec("short", 4),
            reference=ModbusReference("ascii", short=True, marks=2),
            make_exchange=df800_exchange,
            alphabet=HEX_DIGITS,
            longest=LONGEST_ASCII,
        ),
        FuzzedCodec(
            name="modbus-rtu-long-count",
            codec=ModbusRtuCodec(count_bytes=2),
            reference=ModbusReference("rtu", count_bytes=2),
            make_exchange=modbus_exchange,
            alphabet=ALL_BYTES,
            longest=LONGEST_RTU + 1,
        ),
        FuzzedCodec(
            name="modbus-rtu-rejected-read",
            codec=ModbusRtuCodec(max_read=1, rejected_read=2),
            reference=ModbusReference("rtu", rejected_read=2),
            make_exchange=rejected_read_exchange,
            alphabet=ALL_BYTES,
            longest=LONGEST_RTU,
        ),
    ),
    codecs_of_vectors={
        ("vc660", "rtu"): ("modbus-rtu",),
        ("df800", "rtu"): ("df800-rtu",),
        ("df800", "ascii"): ("df800-ascii",),
    },
    missing_requests={
        "vc660-exception": "01 06 20 00 00 01 43 CA",
        "df800-read-error-ascii": "3A 30 31 30 33 30 30 36 34 30 30 30 31 39 37 0D 0A",
        "df800-write-error-ascii": "3A 30 31 30 36 32 30 30 30 30 30 30 31 44 38 0D 0A",
        "df800-read-error-rtu": "01 03 00 64 00 01 C5 D5",
        "df800-write-error-rtu": "01 06 20 00 00 01 43 CA",
    },
    matrix=MATRIX,
    strength_cases=(
        StrengthCase("Modbus RTU, 03, one register", "modbus-rtu", "01 03 30 01 00 01 DA CA", "01 03 02 13 88 B5 12"),
        StrengthCase("Modbus RTU, 06", "modbus-rtu", "01 06 00 02 0B B8 2F 48", "01 06 00 02 0B B8 2F 48"),
        StrengthCase(
            "Modbus ASCII, 03, one register",
            "df800-ascii",
            "3A 30 31 30 33 32 30 30 30 30 30 30 31 44 42 0D 0A",
            "3A 30 31 30 33 30 32 30 31 32 30 44 39 0D 0A",
        ),
        StrengthCase(
            "Modbus ASCII, 06",
            "df800-ascii",
            "3A 30 31 30 36 32 30 30 31 31 33 38 38 33 44 0D 0A",
            "3A 30 31 30 36 32 30 30 31 31 33 38 38 33 44 0D 0A",
        ),
    ),
    similar_reads=similar_reads,
    late_parameters={
        "vc660": ("F00.00", "F00.01", "F00.02", "F00.03"),
        "df800": ("F1.00", "F1.01", "F1.02", "F1.07", "F1.08"),
    },
    stations={
        "vc660": partial(ModbusStation, has_status=True),
        "df800": partial(ModbusStation, has_status=False),
    },
    saved_parameters={"vc660": "F00.02", "df800": "F1.07"},
    written_parameters={
        "vc660": WrittenParameter("F00.02", False, 2, 100),
        "df800": WrittenParameter("F1.00", True, 100, 100),
    },
)
