"""Huanyang HY for the campaigns: exchanges, codec and frames."""

from __future__ import annotations

from random import Random
from typing import Any

from drivebus.families.huanyang import codec as h
from drivebus.protocols.codec import Codec
from verification.codec_fuzz.fuzzed_codec import ALL_BYTES, FuzzedCodec, ValidExchange
from verification.drive_variants import DriveVariant
from verification.families.family_campaign import FamilyCampaign, StrengthCase, WorkedFrame, WrittenParameter
from verification.families.huanyang.matrix import MATRIX
from verification.families.huanyang.station import HuanyangStation
from verification.reference.huanyang import HuanyangReference

LONGEST_FRAME = 8


def huanyang_exchange(rng: Random, codec: Codec) -> ValidExchange:
    """Return an exchange of any function, at times a rejection."""
    address, parameter, word = rng.randint(1, 250), rng.randrange(256), rng.getrandbits(16)
    width = rng.choice((1, 2))
    request = rng.choice(
        (
            h.read_parameter(address, parameter),
            h.write_parameter(address, parameter, word >> 8 * (2 - width), width),
            h.control(address, rng.choice((0x01, 0x08, 0x11, word & 255))),
            h.read_status(address, parameter % 8),
            h.set_frequency(address, word),
        )
    )
    return ValidExchange(request, codec.encode_request(request), codec.encode_reply(_reply(rng, request, width, word)))


def _reply(rng: Random, request: h.HuanyangRequest, width: int, word: int) -> h.HuanyangReply:
    address, function, index = request.address, request.function, request.index
    if rng.random() < 0.15:
        return h.HuanyangReply(address, function, index or word & 255, accepted=False)
    match function:
        case h.CONTROL:
            return h.HuanyangReply(address, function, 0, word & 255, 1)
        case h.FREQUENCY:
            return h.HuanyangReply(address, function, 0, request.value)
        case h.STATUS:
            return h.HuanyangReply(address, function, index, word)
    return h.HuanyangReply(address, function, index, word >> 8 * (2 - width), width)


def similar_reads(variant: DriveVariant, address: int) -> tuple[Any, ...]:
    """Return reads of status items."""
    return tuple(h.read_status(address, item) for item in (1, 2, 3))


RECORDED, PRINTED = "HY01D523B, unininu.tistory.com/288", "unininu.tistory.com/288"
CAMPAIGN = FamilyCampaign(
    fuzzed_codecs=(
        FuzzedCodec(
            name="huanyang-rtu",
            codec=h.HuanyangCodec(),
            reference=HuanyangReference(),
            make_exchange=huanyang_exchange,
            alphabet=ALL_BYTES,
            longest=LONGEST_FRAME,
        ),
    ),
    worked_frames=(
        WorkedFrame("huanyang-read-pd001", "huanyang-rtu", "04 01 03 01 00 00 6D DB", "04 01 02 01 02 F5 AD", RECORDED),
        WorkedFrame(
            "huanyang-read-pd005", "huanyang-rtu", "04 01 03 05 00 00 2C 1A", "04 01 03 05 17 70 22 0E", RECORDED
        ),
        WorkedFrame(
            "huanyang-read-pd008", "huanyang-rtu", "04 01 03 08 00 00 BD D9", "04 01 03 08 08 98 BB B3", RECORDED
        ),
        WorkedFrame("huanyang-read-pd163", "huanyang-rtu", "04 01 03 A3 00 00 CC 39", "04 01 02 A3 04 0C CF", RECORDED),
        WorkedFrame("huanyang-read-pd165", "huanyang-rtu", "04 01 03 A5 00 00 2C 38", "04 01 02 A5 03 4E AD", RECORDED),
        WorkedFrame("huanyang-write-pd008", "huanyang-rtu", "04 02 03 08 04 4C FA EC", "", PRINTED),
        WorkedFrame("huanyang-run-forward", "huanyang-rtu", "04 03 01 01 31 44", "", PRINTED),
        WorkedFrame(
            "huanyang-stop", "huanyang-rtu", "01 03 01 08 F1 8E", "", "gist.github.com/Bouni/803492ed0aab3f944066"
        ),
    ),
    matrix=MATRIX,
    strength_cases=(
        StrengthCase(
            "Huanyang HY, 01, two bytes", "huanyang-rtu", "04 01 03 05 00 00 2C 1A", "04 01 03 05 17 70 22 0E"
        ),
    ),
    similar_reads=similar_reads,
    late_parameters={"huanyang_hy": ("PD004", "PD005", "PD014", "PD015", "PD144")},
    stations={"huanyang_hy": HuanyangStation},
    saved_parameters={"huanyang_hy": "PD014"},
    written_parameters={"huanyang_hy": WrittenParameter("PD014", True, 14, 10)},
    lacks=frozenset({"reset_fault"}),
)
