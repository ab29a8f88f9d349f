"""C320 for the campaigns: exchanges, codecs and frames."""

from __future__ import annotations

from random import Random
from typing import Any

from drivebus.protocols import sunfar as s
from drivebus.protocols.codec import Codec
from drivebus.protocols.sunfar import SunfarCodec
from verification.codec_fuzz.fuzzed_codec import HEX_DIGITS, FuzzedCodec, ValidExchange
from verification.drive_variants import DriveVariant
from verification.families.family_campaign import FamilyCampaign, StrengthCase, WrittenParameter
from verification.families.sunfar.matrix import MATRIX
from verification.families.sunfar.station import SunfarStation
from verification.reference.sunfar import SunfarReference

NIBBLES = bytes(range(16))
TOLERATED_DIGITS = HEX_DIGITS + b"abcdef:;<=>?"


def sunfar_exchange(rng: Random, codec: Codec) -> ValidExchange:
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
    return ValidExchange(
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


def similar_reads(variant: DriveVariant, address: int) -> tuple[Any, ...]:
    """Return reads of monitors."""
    return tuple(s.ReadMonitor(address, item) for item in (0, 2, 3, 5))


CAMPAIGN = FamilyCampaign(
    fuzzed_codecs=(
        FuzzedCodec(
            name="c320-ascii",
            codec=SunfarCodec("ascii"),
            reference=SunfarReference("ascii"),
            make_exchange=sunfar_exchange,
            alphabet=HEX_DIGITS,
            longest=18,
        ),
        FuzzedCodec(
            name="c320-ascii-tolerant",
            codec=SunfarCodec("ascii", "tolerant"),
            reference=SunfarReference("ascii", True),
            make_exchange=sunfar_exchange,
            alphabet=TOLERATED_DIGITS,
            longest=18,
        ),
        FuzzedCodec(
            name="c320-hex",
            codec=SunfarCodec("hex"),
            reference=SunfarReference("hex"),
            make_exchange=sunfar_exchange,
            alphabet=NIBBLES,
            longest=18,
        ),
        FuzzedCodec(
            name="c320-hex-nibble",
            codec=SunfarCodec("hex", nibble=True),
            reference=SunfarReference("hex", True),
            make_exchange=sunfar_exchange,
            alphabet=NIBBLES,
            longest=18,
        ),
    ),
    codecs_of_vectors={
        ("c320", "ascii"): ("c320-ascii", "c320-ascii-tolerant"),
        ("c320", "hex"): ("c320-hex", "c320-hex-nibble"),
    },
    missing_requests={
        "c320-sib-reply-hex": "5A 00 00 01 00 00 00 00 06 00 00 00 07 0D",
        "c320-short-bad-item-ascii": "2A 30 35 31 30 30 30 30 30 30 31 38 36 0D",
        "c320-short-bad-item-hex": "5A 00 05 01 00 00 00 00 00 00 00 00 06 0D",
        "c320-fault-12-ascii": "2A 30 33 31 30 30 30 30 30 30 31 38 34 0D",
    },
    matrix=MATRIX,
    strength_cases=(
        StrengthCase(
            "C320 ASCII",
            "c320-ascii",
            "2A 30 30 31 30 30 30 30 30 30 31 38 31 0D",
            "2A 30 30 30 30 31 30 30 30 30 33 45 37 30 32 36 30 0D",
        ),
        StrengthCase(
            "C320 hex",
            "c320-hex",
            "5A 00 00 01 00 00 00 00 00 00 00 00 01 0D",
            "5A 00 00 00 00 01 00 00 00 00 00 03 E7 00 00 00 EB 0D",
        ),
    ),
    similar_reads=similar_reads,
    late_parameters={"c320": ("F0.1", "F0.2", "F1.10", "F4.0", "F9.4")},
    stations={"c320": SunfarStation},
    statement_options={"setpoint_step": "0.01"},
    saved_parameters={"c320": "F1.10"},
    written_parameters={"c320": WrittenParameter("F0.2", False, 0x0_02, 100)},
)
