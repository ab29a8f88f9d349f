"""Mitsubishi's computer link for the campaigns: exchanges, codec and frames."""

from __future__ import annotations

from random import Random
from typing import Any

from drivebus.families.mitsubishi import codec as f
from drivebus.protocols.codec import Codec
from verification.codec_fuzz.fuzzed_codec import HEX_DIGITS, FuzzedCodec, ValidExchange
from verification.drive_variants import DriveVariant
from verification.families.family_campaign import FamilyCampaign, StrengthCase, WorkedFrame
from verification.families.mitsubishi.matrix import MATRIX
from verification.families.mitsubishi.station import MitsubishiStation
from verification.reference.mitsubishi import MitsubishiReference

LONGEST_FRAME = 12
CONTROL_CODES = b"\x02\x03\x05\x06\x15"


def mitsubishi_exchange(rng: Random, codec: Codec) -> ValidExchange:
    """Return a read, a write, or one of them with a rejection."""
    station, word = rng.randrange(32), rng.getrandbits(16)
    code = rng.choice((*f.READ_DIGITS, *f.WRITE_DIGITS))
    digits = f.WRITE_DIGITS.get(code, 0)
    request = f.MitsubishiRequest(station, code, word % 16**digits)
    reads = f.READ_DIGITS.get(code, 0)
    reply = f.MitsubishiReply(station, word % 16**reads if reads else 0, reads)
    if rng.random() < 0.2:
        reply = f.MitsubishiReply(station, error=rng.randrange(16))
    return ValidExchange(request, codec.encode_request(request), codec.encode_reply(reply))


def similar_reads(variant: DriveVariant, address: int) -> tuple[Any, ...]:
    """Return reads of four digits."""
    return tuple(f.MitsubishiRequest(address, code) for code in (0x6F, 0x70, 0x71))


PROGRAM = "LinuxCNC mitsub_vfd.py, station 01"
CAMPAIGN = FamilyCampaign(
    fuzzed_codecs=(
        FuzzedCodec(
            name="mitsubishi-ascii",
            codec=f.MitsubishiCodec(),
            reference=MitsubishiReference(),
            make_exchange=mitsubishi_exchange,
            alphabet=HEX_DIGITS + CONTROL_CODES,
            longest=LONGEST_FRAME,
        ),
    ),
    worked_frames=(
        WorkedFrame(
            "mitsubishi-read-6f",
            "mitsubishi-ascii",
            "05 30 31 36 46 31 30 45",
            "02 30 31 31 37 37 30 03 33 30",
            "LinuxCNC mitsub_vfd.py, station 01; reply: FR-F500 manual, page 114",
        ),
        WorkedFrame("mitsubishi-read-7a", "mitsubishi-ascii", "05 30 31 37 41 31 30 41", "", PROGRAM),
        WorkedFrame("mitsubishi-stop", "mitsubishi-ascii", "05 30 31 46 41 31 30 30 37 39", "", PROGRAM),
        WorkedFrame("mitsubishi-run-forward", "mitsubishi-ascii", "05 30 31 46 41 31 30 32 37 42", "06 30 31", PROGRAM),
        WorkedFrame("mitsubishi-run-reverse", "mitsubishi-ascii", "05 30 31 46 41 31 30 34 37 44", "", PROGRAM),
        WorkedFrame("mitsubishi-25-hz", "mitsubishi-ascii", "05 30 31 45 44 31 30 39 43 34 46 42", "", PROGRAM),
    ),
    matrix=MATRIX,
    strength_cases=(
        StrengthCase(
            "Mitsubishi, read of four digits",
            "mitsubishi-ascii",
            "05 30 31 36 46 31 30 45",
            "02 30 31 31 37 37 30 03 33 30",
        ),
        StrengthCase("Mitsubishi, acknowledgement", "mitsubishi-ascii", "05 30 31 46 41 31 30 32 37 42", "06 30 31"),
    ),
    similar_reads=similar_reads,
    late_parameters={},
    stations={"fr_e500": MitsubishiStation},
    lacks=frozenset({"read", "write", "reset_fault"}),
)
