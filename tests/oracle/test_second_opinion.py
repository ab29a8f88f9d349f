"""The C320 and DZB100 codecs agree with the reference codecs (T02, T03, T05, T06, T19).

Both must build the same bytes, refuse the same replies and read the same fields out of the others. What drivebus does
on purpose otherwise than the manual's letter is a named choice. The whole run: ``oracle.__main__``.
"""

from __future__ import annotations

from random import Random
from typing import Any

import pytest

from drivebus.protocols.codec import DecodeResult
from drivebus.protocols.dzb100 import Dzb100Codec
from drivebus.protocols.sunfar import SunfarCodec
from oracle.__main__ import totals
from oracle.c320_side import C320Comparison
from oracle.compare import ComparedSide, compare
from oracle.dzb100_side import Dzb100Comparison
from verification.reference.sunfar import SunfarReference


@pytest.mark.parametrize(
    ("side", "count"),
    [(C320Comparison("ascii"), 10_000), (C320Comparison("hex"), 10_000), (Dzb100Comparison(), 20_000)],
    ids=lambda value: getattr(value, "name", ""),
)
def test_both_readings_of_the_manual_agree(side: ComparedSide, count: int) -> None:
    tally = compare(side, Random(f"slice/{side.name}"), count)
    assert not tally.disagreements
    seen = totals(tally)
    assert min(seen["built"], seen["accepted"], seen["refused"]) > count // 10


class SumBlind(SunfarCodec):
    def decode_reply(self, request: Any, data: bytes) -> DecodeResult:
        return super().decode_reply(
            request, SunfarReference(self.encoding).seal(data[1:-5]) if len(data) in (11, 18) else data
        )


class AddressBlind(SunfarCodec):
    def encode_request(self, request: Any) -> bytes:
        return super().encode_request(request).replace(b"*00", b"*01")


class CaseBlind(Dzb100Codec):
    def decode_reply(self, request: Any, data: bytes) -> DecodeResult:
        return super().decode_reply(request, data[:3] + data[3:].upper())


class HeadBlind(Dzb100Codec):
    def decode_reply(self, request: Any, data: bytes) -> DecodeResult:
        return super().decode_reply(request, bytes((request.head,)) + data[1:])


@pytest.mark.parametrize(
    "side",
    [
        C320Comparison("ascii", SunfarCodec("ascii", digits="tolerant")),
        C320Comparison("hex", SunfarCodec("hex", nibble=True)),
        C320Comparison("ascii", SumBlind("ascii")),
        C320Comparison("ascii", AddressBlind("ascii")),
        Dzb100Comparison(CaseBlind()),
        Dzb100Comparison(HeadBlind()),
    ],
    ids=["tolerant digits", "nibbles", "blind to sums", "one address wrong", "lower case", "blind to heads"],
)
def test_a_codec_that_reads_otherwise_is_found(side: ComparedSide) -> None:
    assert compare(side, Random(2), 3_000).disagreed > 0
