"""The campaign ``fuzz`` finds no violation in the product and every planted one (I8)."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import combinations
from random import Random
from types import FrameType
from typing import Any

import pytest

from drivebus.errors import ProtocolError
from drivebus.protocols.codec import Complete, CompleteIfSilent, DecodeResult, Incomplete
from drivebus.protocols.dzb100 import codec as dzb_codec
from drivebus.protocols.modbus import rtu
from drivebus.protocols.sunfar import frame as sunfar_frame
from verification.campaign import CampaignRun, map_in_order
from verification.campaigns import fuzz
from verification.codec_fuzz import fuzz_block
from verification.codec_fuzz.collision_odds import CollisionOdds, false_accept_limit, noise_odds
from verification.codec_fuzz.fuzz_block import (
    DAMAGE_KINDS,
    DamageBase,
    RefusedBytes,
    accepted_size,
    decode_outcome,
    feed_incrementally,
)
from verification.codec_fuzz.fuzzed_codec import FuzzedCodec
from verification.families.campaigns import FUZZED_CODECS
from verification.reference.frame_shapes import FrameShape

every_entry = pytest.mark.parametrize("entry", FUZZED_CODECS.values(), ids=FUZZED_CODECS)


def campaign(budget: int, seed: int = 1) -> CampaignRun:
    campaign_run = CampaignRun(campaign="fuzz", seed=seed, budget=budget)
    fuzz.run(campaign_run)
    return campaign_run


def test_the_costs_of_a_codec_are_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fuzz, "FUZZED_CODECS", {"dzb100": FUZZED_CODECS["dzb100"]})
    (costs,) = fuzz.decode_costs(Random(1)).values()
    assert costs and min(costs.values()) > 0


def test_garbage_finds_no_violation_and_another_seed_sends_other_garbage() -> None:
    first, other = campaign(3_000), campaign(3_000, seed=2)
    assert not first.violations
    assert first.digest != other.digest
    assert first.trials >= 3_000
    assert set(first.figures) == set(FUZZED_CODECS)


def test_results_of_two_processes_keep_their_order() -> None:
    assert list(map_in_order(abs, range(-40, 0), in_process=False)) == list(
        map_in_order(abs, range(-40, 0), in_process=True)
    )


@every_entry
def test_codec_and_reference_agree_on_valid_exchanges(entry: FuzzedCodec) -> None:
    """A reference that accepted nothing would agree on all garbage, too."""
    rng = Random(entry.name)
    for _ in range(60):
        exchange = entry.make_exchange(rng, entry.codec)
        assert entry.reference.accepted_size(exchange.sent, exchange.received) == len(exchange.received)
        assert entry.reference.accepted_size(b"", exchange.sent) == len(exchange.sent)
        verdict = entry.codec.decode_reply(exchange.request, exchange.received)
        assert not isinstance(verdict, Incomplete)
        assert verdict.size == len(exchange.received)
        assert any(form.matches(exchange.received) for form in entry.forms(exchange.sent))
        assert entry.reference.reseal(exchange.received) == exchange.received


with_broadcast = pytest.mark.parametrize(
    "entry",
    [
        pytest.param(entry, id=name)
        for name, entry in FUZZED_CODECS.items()
        if entry.codec.broadcast_address is not None
    ],
)


@with_broadcast
def test_a_broadcast_has_no_valid_reply(entry: FuzzedCodec) -> None:
    rng = Random(entry.name)
    made = [exchange for exchange in (entry.exchange(rng) for _ in range(400)) if as_broadcast(entry, exchange.request)]
    assert made
    for exchange in made:
        assert entry.reference.accepted_size(b"", exchange.sent) == len(exchange.sent)
        assert entry.reference.accepted_size(exchange.sent, exchange.received) is None
        assert not entry.forms(exchange.sent)
        decode = partial(entry.codec.decode_reply, exchange.request)
        assert isinstance(decode_outcome(decode, exchange.received), RefusedBytes)


def as_broadcast(entry: FuzzedCodec, request: Any) -> bool:
    return entry.codec.address_of(request) == entry.codec.broadcast_address


# -- what is planted is found --------------------------------------------------------------------------------------


class FaultyCodec:
    """Codec with a faulty master side."""

    def __init__(self, codec: Any, decode: Callable[[Any, Any, bytes], DecodeResult]) -> None:
        self._codec, self._decode = codec, decode

    def __getattr__(self, name: str) -> Any:
        return getattr(self._codec, name)

    def decode_reply(self, request: Any, data: bytes) -> DecodeResult:
        return self._decode(self._codec, request, data)


def violations(entry: FuzzedCodec, size: int = 20_000) -> list[str]:
    return fuzz_block.run_block(entry, Random(1), size).violations


def faulty(name: str, decode: Callable[[Any, Any, bytes], DecodeResult]) -> list[str]:
    entry = FUZZED_CODECS[name]
    return violations(replace(entry, codec=FaultyCodec(entry.codec, decode)))


def test_a_sum_that_is_not_compared_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sunfar_frame, "_check_checksum", lambda frame, found: None)
    assert any(text.startswith("reference: c320-ascii reply") for text in violations(FUZZED_CODECS["c320-ascii"]))
    assert any(text.startswith("reference: c320-hex request") for text in violations(FUZZED_CODECS["c320-hex"]))


def test_a_crc_that_is_not_compared_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rtu, "check_frame", lambda data, size: data[: size - 2])
    assert any(text.startswith("reference: modbus-rtu reply") for text in violations(FUZZED_CODECS["modbus-rtu"]))


def test_a_dzb100_constant_that_is_not_compared_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    framed = dzb_codec.check_head
    monkeypatch.setattr(
        dzb_codec, "check_head", lambda data: framed(data[:1] + b"\x03" + data[2:] if data[1:] else data)
    )
    assert any(text.startswith("reference: dzb100") for text in violations(FUZZED_CODECS["dzb100"]))


def test_t02_digits_that_a_strict_codec_must_reject_are_found() -> None:
    tolerant = FUZZED_CODECS["c320-ascii-tolerant"]
    assert any(
        "reference None" in text
        for text in violations(replace(tolerant, reference=FUZZED_CODECS["c320-ascii"].reference))
    )


def test_a_rejected_valid_frame_is_found() -> None:
    """A master that does not know the short error waits for more bytes (T15)."""
    standard = FUZZED_CODECS["modbus-rtu"].codec
    found = violations(
        replace(FUZZED_CODECS["df800-rtu"], codec=MixedCodec(standard, FUZZED_CODECS["df800-rtu"].codec))
    )
    assert any("codec accepts None, reference 5" in text for text in found)


class MixedCodec(FaultyCodec):
    """Codec that decodes like the first and encodes like the second."""

    def __init__(self, receiver: Any, sender: Any) -> None:
        super().__init__(sender, lambda _, request, data: receiver.decode_reply(request, data))


def test_i8_any_other_exception_is_found() -> None:
    def decode(codec: Any, request: Any, data: bytes) -> DecodeResult:
        int(data[3:5] or b"0", 16)  # accepts signs and blanks (T19)
        return codec.decode_reply(request, data)

    assert any(text.startswith("I8 dzb100") and "ValueError" in text for text in faulty("dzb100", decode))


def test_a_codec_that_searches_for_frames_is_found() -> None:
    def decode(codec: Any, request: Any, data: bytes) -> DecodeResult:
        return codec.decode_reply(request, data[max(0, data.find(b"*")) :])

    assert any(text.startswith(("feed", "reference")) for text in faulty("c320-ascii", decode))


@pytest.mark.parametrize("need", [lambda need: need + 9, lambda need: need - 17], ids=["too much", "too little"])
def test_a_wrong_need_is_found(need: Callable[[int], int]) -> None:
    def decode(codec: Any, request: Any, data: bytes) -> DecodeResult:
        verdict = codec.decode_reply(request, data)
        return Incomplete(need(verdict.need)) if isinstance(verdict, Incomplete) else verdict

    assert any(text.startswith("feed") and "need" in text for text in faulty("c320-ascii", decode))


def test_more_false_accepts_than_expected_are_a_violation(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fuzz, "false_accept_limit", lambda expected: expected / 2)
    assert any(text.startswith("by chance: dzb100 garbled") for text in campaign(8_000).violations)


# -- feeding -------------------------------------------------------------------------------------------------------


def test_bytes_after_a_frame_must_not_change_it() -> None:
    def decode(data: bytes) -> DecodeResult:
        return Incomplete(2) if len(data) < 2 else Complete(len(data) > 3, 2)

    assert feed_incrementally(decode, b"ab", 0, 9) == (Complete(False, 2), "")
    assert "4 bytes" in feed_incrementally(decode, b"abcd", 0, 9)[1]


def test_a_message_complete_only_by_silence_may_still_change() -> None:
    def decode(data: bytes) -> DecodeResult:
        if len(data) < 2:
            return Incomplete(2)
        return CompleteIfSilent("error", 2, 4) if len(data) < 4 else Complete("echo", 4)

    assert feed_incrementally(decode, b"abcd", 0, 9) == (Complete("echo", 4), "")
    assert [accepted_size(decode(data), data) for data in (b"a", b"ab", b"abc", b"abcd")] == [None, 2, None, 4]


def test_a_rejection_keeps_its_key_and_parameters() -> None:
    def decode(data: bytes) -> DecodeResult:
        raise ProtocolError("a.key", expected=1, found=len(data), size=3)

    assert decode_outcome(decode, b"xy") == RefusedBytes("ProtocolError", "a.key", {"expected": 1, "found": 2}, 3)
    assert "b" not in feed_incrementally(decode, b"", 0, 9)[1]


# -- odds ----------------------------------------------------------------------------------------------------------


def exact(entry: FuzzedCodec, sent: bytes, frame: bytes, places: tuple[int, ...]) -> float:
    """Return the share of all other values of these bytes that the reference accepts."""
    hits, damaged = 0, bytearray(frame)
    for number in range(255 ** len(places)):
        for place in places:
            number, change = divmod(number, 255)
            damaged[place] = frame[place] ^ (change + 1)
        hits += entry.reference.accepted_size(sent, bytes(damaged)) is not None
    return hits / 255 ** len(places)


@every_entry
def test_the_odds_of_one_other_byte_are_never_too_small(entry: FuzzedCodec) -> None:
    rng = Random(entry.name)
    for _ in range(2):
        exchange = entry.make_exchange(rng, entry.codec)
        for sent, frame in ((exchange.sent, exchange.received), (b"", exchange.sent)):
            odds = CollisionOdds(frame, entry.forms(sent), entry.alphabet, entry.reference.marks)
            for place in range(min(len(frame), 20)):
                assert exact(entry, sent, frame, (place,)) <= odds.substituted((place,)) + 1e-12


def test_the_odds_of_the_dzb100_and_of_two_bytes_under_a_crc_are_exact() -> None:
    dzb, modbus = FUZZED_CODECS["dzb100"], FUZZED_CODECS["modbus-rtu"]
    sent, frame = bytes.fromhex("5203013033323330303030"), bytes.fromhex("5203063033323330303634")
    odds = CollisionOdds(frame, dzb.forms(sent), dzb.alphabet, 0)
    for places in [(2,), (7,), (7, 10), (3, 8)]:
        assert odds.substituted(places) == pytest.approx(exact(dzb, sent, frame, places))
    sent, frame = bytes.fromhex("010330010001DACA"), bytes.fromhex("0103021388B512")
    odds = CollisionOdds(frame, modbus.forms(sent), modbus.alphabet, 0)
    found = {places: exact(modbus, sent, frame, places) for places in combinations((3, 4, 6), 2)}
    assert any(found.values())
    assert {places: odds.substituted(places) for places in found} == pytest.approx(found)


def test_odds_of_noise_are_the_product_of_the_fields() -> None:
    """The odds are 2^-71 for a DZB100 read reply, and 2^-40 for an RTU read of one register and for each exception."""
    dzb, modbus = FUZZED_CODECS["dzb100"], FUZZED_CODECS["modbus-rtu"]
    (size, done), (_, refused) = noise_odds(dzb.forms(bytes.fromhex("5203013033323330303030")))
    assert (size, done + refused) == (11, pytest.approx(2.0**-71))
    chances = dict(noise_odds(modbus.forms(bytes.fromhex("010330010001DACA"))))
    assert chances == {7: pytest.approx(2.0**-40), 5: pytest.approx(10 * 2.0**-40)}


@every_entry
def test_garbled_ends_are_accepted_as_often_as_expected(entry: FuzzedCodec) -> None:
    rng, accepted, expected = Random(7), 0, 0.0
    for _ in range(10):
        exchange = entry.make_exchange(rng, entry.codec)
        target, _ = fuzz_block.fuzz_targets(entry, exchange)
        base = DamageBase(
            exchange.received, exchange.sent, entry.alphabet, entry.reference.marks, entry.reference.reseal
        )
        for _ in range(100):
            data, places = DAMAGE_KINDS["garbled"](rng, base)
            expected += target.odds.garbled(places[0])
            accepted += data != exchange.received and entry.reference.accepted_size(exchange.sent, data) is not None
    assert accepted <= false_accept_limit(expected)


def test_a_shape_shorter_than_the_frame_counts() -> None:
    form = FrameShape((frozenset(b"a"), frozenset(b"b")), range(0), "none")
    assert CollisionOdds(b"axy", (form,), b"bc", 0).garbled(1) == 0.5
    assert CollisionOdds(b"axy", (form,), b"bc", 0).substituted((1,)) == pytest.approx(1 / 255)


# -- cost ----------------------------------------------------------------------------------------------------------


def steps(decode: Callable[[bytes], object], data: bytes) -> int:
    """Return the number of Python lines that a decoder runs."""
    count = 0

    def trace(frame: FrameType, event: str, arg: object) -> Any:
        nonlocal count
        count += event == "line"
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        decode_outcome(decode, data)
    finally:
        sys.settrace(before)
    return count


@every_entry
def test_the_cost_of_garbage_grows_linearly(entry: FuzzedCodec) -> None:
    rng = Random(3)
    for decode in fuzz.decoders(rng, entry):
        for data in fuzz.garbage(rng, entry):
            for size in (16, 64, 256):
                assert steps(decode, data[:size]) <= 10 * size + 100
