"""The C320 and DZB100 codecs agree with the reference codecs (T02, T03, T05, T06, T19).

Both must build the same bytes, reject the same replies and read the same fields from the others. A deliberate deviation
of the product from the manual has a name. The whole run: ``python -m verification.reference_comparison``.
"""

from __future__ import annotations

import json
from random import Random
from typing import Any

import pytest

from drivebus.protocols.codec import DecodeResult
from drivebus.protocols.dzb100 import Dzb100Codec
from drivebus.protocols.sunfar import SunfarCodec
from verification.reference.sunfar import SunfarReference
from verification.reference_comparison.__main__ import REPORT, rows, totals
from verification.reference_comparison.c320 import C320Comparison
from verification.reference_comparison.compare import ComparedSide, compare
from verification.reference_comparison.dzb100 import Dzb100Comparison


@pytest.mark.parametrize(
    ("side", "count"),
    [(C320Comparison("ascii"), 10_000), (C320Comparison("hex"), 10_000), (Dzb100Comparison(), 20_000)],
    ids=lambda value: getattr(value, "name", ""),
)
def test_product_and_reference_agree(side: ComparedSide, count: int) -> None:
    tally = compare(side, Random(f"slice/{side.name}"), count)
    assert not tally.disagreements
    counts = totals(tally)
    assert min(counts["built"], counts["accepted"], counts["refused"]) > count // 10


class ChecksumIgnored(SunfarCodec):
    def decode_reply(self, request: Any, data: bytes) -> DecodeResult:
        return super().decode_reply(
            request, SunfarReference(self.encoding).seal(data[1:-5]) if len(data) in (11, 18) else data
        )


class WrongAddress(SunfarCodec):
    def encode_request(self, request: Any) -> bytes:
        return super().encode_request(request).replace(b"*00", b"*01")


class CaseIgnored(Dzb100Codec):
    def decode_reply(self, request: Any, data: bytes) -> DecodeResult:
        return super().decode_reply(request, data[:3] + data[3:].upper())


class HeadIgnored(Dzb100Codec):
    def decode_reply(self, request: Any, data: bytes) -> DecodeResult:
        return super().decode_reply(request, bytes((request.head,)) + data[1:])


@pytest.mark.parametrize(
    "side",
    [
        C320Comparison("ascii", SunfarCodec("ascii", digits="tolerant")),
        C320Comparison("hex", SunfarCodec("hex", nibble=True)),
        C320Comparison("ascii", ChecksumIgnored("ascii")),
        C320Comparison("ascii", WrongAddress("ascii")),
        Dzb100Comparison(CaseIgnored()),
        Dzb100Comparison(HeadIgnored()),
    ],
    ids=["tolerant digits", "nibbles", "checksum ignored", "wrong address", "lower case", "head ignored"],
)
def test_a_codec_that_deviates_is_found(side: ComparedSide) -> None:
    assert compare(side, Random(2), 3_000).disagreed > 0


@pytest.mark.parametrize("page", ["reference-codec-comparison.md", "reference-codec-comparison.zh.md"])
def test_the_pages_show_the_figures_of_the_committed_run(page: str) -> None:
    text = (REPORT.parent / page).read_text(encoding="utf-8")
    found = json.loads(REPORT.read_text(encoding="utf-8"))
    assert [row for row in rows(found) if row not in text] == []
    assert found["commit"] in text
