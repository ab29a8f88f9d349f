"""DZB100 for the campaigns: exchanges, codecs and frames."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from random import Random
from typing import Any

from drivebus.errors import ProtocolError
from drivebus.protocols import dzb100 as d
from drivebus.protocols.codec import Codec
from drivebus.protocols.dzb100 import Dzb100Codec
from drivebus.protocols.dzb100.messages import FREQUENCY_CODINGS, FaultCoding
from verification.codec_fuzz.fuzzed_codec import HEX_DIGITS, FuzzedCodec, ValidExchange
from verification.drive_variants import DriveVariant
from verification.families.dzb100.matrix import MATRIX
from verification.families.dzb100.station import Dzb100Station
from verification.families.family_campaign import FamilyCampaign, StrengthCase, WrittenParameter
from verification.reference.dzb100 import Dzb100Reference

FAULT_CODINGS: tuple[FaultCoding, ...] = ("decimal", "hex")


def dzb100_exchange(rng: Random, codec: Codec) -> ValidExchange:
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
    return ValidExchange(request, sent, codec.encode_reply(reply))


def dzb100_broadcast(request: Any, codec: Codec) -> Any:
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


def similar_reads(variant: DriveVariant, address: int) -> tuple[Any, ...]:
    """Return queries."""
    return tuple(d.Dzb100Query(address, item) for item in (0, 1, 2))


CAMPAIGN = FamilyCampaign(
    fuzzed_codecs=(
        FuzzedCodec(
            name="dzb100",
            codec=Dzb100Codec(),
            reference=Dzb100Reference(),
            make_exchange=dzb100_exchange,
            alphabet=HEX_DIGITS + b"\x06\x07",
            longest=11,
            interpret=dzb100_interpretations,
            broadcast_of=dzb100_broadcast,
        ),
    ),
    codecs_of_vectors={("dzb100", "ascii"): ("dzb100",)},
    missing_requests={
        "dzb100-status-fault": "51 03 01 30 37 30 33 30 30 30 30",
        "dzb100-refused": "50 03 01 30 32 39 39 30 30 30 30",
    },
    matrix=MATRIX,
    strength_cases=(
        StrengthCase("DZB100", "dzb100", "52 03 01 30 33 32 33 30 30 30 30", "52 03 06 30 33 32 33 30 30 36 34"),
    ),
    similar_reads=similar_reads,
    late_parameters={"dzb100": ("00", "01", "10", "23", "77")},
    stations={"dzb100": Dzb100Station},
    saved_parameters={"dzb100": "10"},
    written_parameters={"dzb100": WrittenParameter("10", True, 10, 10)},
)
