"""Our C320 and DZB100 codecs against naive ones that were written from the manuals alone (T02, T03, T05, T06, T19).

Both must build the same bytes, refuse the same replies and read the same fields out of the others. What drivebus does
on purpose otherwise than the manual's letter is a named choice. The whole run: ``oracle.__main__``.
"""

from __future__ import annotations

from random import Random
from typing import Any

import pytest

from drivebus.message import Verdict
from drivebus.protocols.dzb import DzbCodec
from drivebus.protocols.sifang import SifangCodec
from oracle import naive_c320 as naive
from oracle.__main__ import totals
from oracle.c320_side import C320Side
from oracle.compare import Side, compare
from oracle.dzb100_side import Dzb100Side


@pytest.mark.parametrize(
    ("side", "count"),
    [(C320Side("ascii"), 10_000), (C320Side("hex"), 10_000), (Dzb100Side(), 20_000)],
    ids=lambda value: getattr(value, "name", ""),
)
def test_both_readings_of_the_manual_agree(side: Side, count: int) -> None:
    tally = compare(side, Random(f"slice/{side.name}"), count)
    assert not tally.disagreements
    seen = totals(tally)
    assert min(seen["built"], seen["accepted"], seen["refused"]) > count // 10


class SumBlind(SifangCodec):
    def decode_reply(self, request: Any, data: bytes) -> Verdict:
        return super().decode_reply(request, naive.seal(self.encoding, data[1:-5]) if len(data) in (11, 18) else data)


class AddressBlind(SifangCodec):
    def encode_request(self, request: Any) -> bytes:
        return super().encode_request(request).replace(b"*00", b"*01")


class CaseBlind(DzbCodec):
    def decode_reply(self, request: Any, data: bytes) -> Verdict:
        return super().decode_reply(request, data[:3] + data[3:].upper())


class HeadBlind(DzbCodec):
    def decode_reply(self, request: Any, data: bytes) -> Verdict:
        return super().decode_reply(request, bytes((request.head,)) + data[1:])


@pytest.mark.parametrize(
    "side",
    [
        C320Side("ascii", SifangCodec("ascii", digits="tolerant")),
        C320Side("hex", SifangCodec("hex", nibble=True)),
        C320Side("ascii", SumBlind("ascii")),
        C320Side("ascii", AddressBlind("ascii")),
        Dzb100Side(CaseBlind()),
        Dzb100Side(HeadBlind()),
    ],
    ids=["tolerant digits", "nibbles", "blind to sums", "one address wrong", "lower case", "blind to heads"],
)
def test_a_codec_that_reads_otherwise_is_found(side: Side) -> None:
    assert compare(side, Random(2), 3_000).disagreed > 0
