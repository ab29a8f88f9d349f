"""G01, G02, I8: the fuzz campaign finds nothing, and finds what is planted."""

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
from drivebus.lab.campaign import Session
from drivebus.lab.campaigns import fuzz
from drivebus.lab.codecs import cost, garbage
from drivebus.lab.codecs.feed import Refusal, feed, outcome, taken
from drivebus.lab.codecs.judges.forms import Form
from drivebus.lab.codecs.mutate import KINDS, Base
from drivebus.lab.codecs.odds import Odds, limit, noise
from drivebus.lab.codecs.roster import ROSTER, Entry
from drivebus.lab.crew import in_order
from drivebus.message import Complete, CompleteIfSilent, Incomplete, Verdict
from drivebus.protocols.dzb import codec as dzb_codec
from drivebus.protocols.modbus import rtu
from drivebus.protocols.sifang import frame as sifang_frame

every_entry = pytest.mark.parametrize("entry", ROSTER.values(), ids=ROSTER)


def campaign(budget: int, seed: int = 1) -> Session:
    session = Session("fuzz", seed, budget)
    fuzz.run(session)
    return session


@pytest.fixture(autouse=True)
def _no_figures_of_this_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cost, "figures", lambda rng: {})


def test_g01_g02_garbage_finds_nothing_and_the_same_seed_finds_it_again() -> None:
    first, second, other = campaign(3_000), campaign(3_000), campaign(3_000, seed=2)
    assert not first.violations
    assert (first.digest, first.trials) == (second.digest, second.trials)
    assert first.digest != other.digest
    assert first.trials >= 3_000
    assert set(first.figures) == set(ROSTER)


def test_pieces_come_back_in_their_order_from_two_processes() -> None:
    assert list(in_order(abs, range(-40, 0), alone=False)) == list(in_order(abs, range(-40, 0), alone=True))


@every_entry
def test_codec_and_judge_agree_on_all_lawful_talk(entry: Entry) -> None:
    """A judge that took nothing would agree on all garbage too."""
    rng = Random(entry.name)
    for _ in range(60):
        exchange = entry.talk(rng, entry.codec)
        assert entry.judge.size(exchange.sent, exchange.received) == len(exchange.received)
        assert entry.judge.size(b"", exchange.sent) == len(exchange.sent)
        verdict = entry.codec.decode_reply(exchange.request, exchange.received)
        assert not isinstance(verdict, Incomplete)
        assert verdict.size == len(exchange.received)
        assert any(form.holds(exchange.received) for form in entry.forms(exchange.sent))
        assert entry.judge.seal(exchange.received) == exchange.received


@every_entry
def test_nobody_answers_a_broadcast(entry: Entry) -> None:
    rng = Random(entry.name)
    made = [exchange for exchange in (entry.exchange(rng) for _ in range(400)) if everybody(entry, exchange.request)]
    assert made
    for exchange in made:
        assert entry.judge.size(b"", exchange.sent) == len(exchange.sent)
        assert entry.judge.size(exchange.sent, exchange.received) is None
        assert not entry.forms(exchange.sent)
        decode = partial(entry.codec.decode_reply, exchange.request)
        assert isinstance(outcome(decode, exchange.received), Refusal)


def everybody(entry: Entry, request: Any) -> bool:
    return entry.codec.address_of(request) == entry.codec.broadcast_address


# -- what is planted is found --------------------------------------------------------------------------------------


class Faulty:
    """A codec whose host side is wrong."""

    def __init__(self, codec: Any, decode: Callable[[Any, Any, bytes], Verdict]) -> None:
        self._codec, self._decode = codec, decode

    def __getattr__(self, name: str) -> Any:
        return getattr(self._codec, name)

    def decode_reply(self, request: Any, data: bytes) -> Verdict:
        return self._decode(self._codec, request, data)


def violations(entry: Entry, size: int = 20_000) -> list[str]:
    return garbage.block(entry, Random(1), size).violations


def faulty(name: str, decode: Callable[[Any, Any, bytes], Verdict]) -> list[str]:
    entry = ROSTER[name]
    return violations(replace(entry, codec=Faulty(entry.codec, decode)))


def test_a_sum_that_is_not_compared_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sifang_frame, "_check_sum", lambda frame, found: None)
    assert any(text.startswith("G02 c320-ascii reply") for text in violations(ROSTER["c320-ascii"]))
    assert any(text.startswith("G02 c320-hex request") for text in violations(ROSTER["c320-hex"]))


def test_a_crc_that_is_not_compared_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rtu, "checked", lambda data, size: data[: size - 2])
    assert any(text.startswith("G02 modbus-rtu reply") for text in violations(ROSTER["modbus-rtu"]))


def test_the_constant_of_the_dzb100_not_compared_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    framed = dzb_codec.framed
    monkeypatch.setattr(dzb_codec, "framed", lambda data: framed(data[:1] + b"\x03" + data[2:] if data[1:] else data))
    assert any(text.startswith("G02 dzb100") for text in violations(ROSTER["dzb100"]))


def test_t02_digits_that_a_strict_reader_may_not_take_are_found() -> None:
    tolerant = ROSTER["c320-ascii-tolerant"]
    assert any("judge None" in text for text in violations(replace(tolerant, judge=ROSTER["c320-ascii"].judge)))


def test_a_refused_frame_that_is_lawful_is_found() -> None:
    """T15: a master that does not know the short error waits for more."""
    standard = ROSTER["modbus-rtu"].codec
    found = violations(replace(ROSTER["df800-rtu"], codec=Both(standard, ROSTER["df800-rtu"].codec)))
    assert any("codec takes None, judge 5" in text for text in found)


class Both(Faulty):
    """Hears like the first, says like the second."""

    def __init__(self, hears: Any, says: Any) -> None:
        super().__init__(says, lambda _, request, data: hears.decode_reply(request, data))


def test_i8_any_other_exception_is_found() -> None:
    def decode(codec: Any, request: Any, data: bytes) -> Verdict:
        int(data[3:5] or b"0", 16)  # T19
        return codec.decode_reply(request, data)

    assert any(text.startswith("I8 dzb100") and "ValueError" in text for text in faulty("dzb100", decode))


def test_a_hunting_codec_is_found() -> None:
    def decode(codec: Any, request: Any, data: bytes) -> Verdict:
        return codec.decode_reply(request, data[max(0, data.find(b"*")) :])

    assert any(text.startswith(("G01", "G02")) for text in faulty("c320-ascii", decode))


@pytest.mark.parametrize("need", [lambda need: need + 9, lambda need: need - 17], ids=["too much", "too little"])
def test_a_need_that_is_not_honest_is_found(need: Callable[[int], int]) -> None:
    def decode(codec: Any, request: Any, data: bytes) -> Verdict:
        verdict = codec.decode_reply(request, data)
        return Incomplete(need(verdict.need)) if isinstance(verdict, Incomplete) else verdict

    assert any(text.startswith("G01") and "need" in text for text in faulty("c320-ascii", decode))


def test_more_hits_than_chance_allows_are_a_violation(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fuzz, "limit", lambda expected: expected / 2)
    assert any(text.startswith("G02 dzb100 garbled") for text in campaign(8_000).violations)


# -- feeding -------------------------------------------------------------------------------------------------------


def test_g01_bytes_after_a_frame_may_not_change_it() -> None:
    def decode(data: bytes) -> Verdict:
        return Incomplete(2) if len(data) < 2 else Complete(len(data) > 3, 2)

    assert feed(decode, b"ab", 0, 9) == (Complete(False, 2), "")
    assert "4 bytes" in feed(decode, b"abcd", 0, 9)[1]


def test_ruling_11_a_message_that_silence_ends_may_still_become_another() -> None:
    def decode(data: bytes) -> Verdict:
        if len(data) < 2:
            return Incomplete(2)
        return CompleteIfSilent("error", 2, 4) if len(data) < 4 else Complete("echo", 4)

    assert feed(decode, b"abcd", 0, 9) == (Complete("echo", 4), "")
    assert [taken(decode(data), data) for data in (b"a", b"ab", b"abc", b"abcd")] == [None, 2, None, 4]


def test_a_refusal_is_told_with_all_that_it_says() -> None:
    def decode(data: bytes) -> Verdict:
        raise ProtocolError("a.key", expected=1, found=len(data), size=3)

    assert outcome(decode, b"xy") == Refusal("ProtocolError", "a.key", {"expected": 1, "found": 2}, 3)
    assert "b" not in feed(decode, b"", 0, 9)[1]


# -- odds ----------------------------------------------------------------------------------------------------------


def exact(entry: Entry, sent: bytes, frame: bytes, places: tuple[int, ...]) -> float:
    """The share of all other values of these bytes that the judge takes."""
    hits, damaged = 0, bytearray(frame)
    for number in range(255 ** len(places)):
        for place in places:
            number, change = divmod(number, 255)
            damaged[place] = frame[place] ^ (change + 1)
        hits += entry.judge.size(sent, bytes(damaged)) is not None
    return hits / 255 ** len(places)


@every_entry
def test_the_odds_of_one_other_byte_are_never_too_small(entry: Entry) -> None:
    rng = Random(entry.name)
    for _ in range(2):
        exchange = entry.talk(rng, entry.codec)
        for sent, frame in ((exchange.sent, exchange.received), (b"", exchange.sent)):
            odds = Odds(frame, entry.forms(sent), entry.alphabet, entry.judge.marks)
            for place in range(min(len(frame), 20)):
                assert exact(entry, sent, frame, (place,)) <= odds.substituted((place,)) + 1e-12


def test_the_odds_of_the_dzb100_and_of_two_bytes_under_a_crc_are_exact() -> None:
    dzb, modbus = ROSTER["dzb100"], ROSTER["modbus-rtu"]
    sent, frame = bytes.fromhex("5203013033323330303030"), bytes.fromhex("5203063033323330303634")
    odds = Odds(frame, dzb.forms(sent), dzb.alphabet, 0)
    for places in [(2,), (7,), (7, 10), (3, 8)]:
        assert odds.substituted(places) == pytest.approx(exact(dzb, sent, frame, places))
    sent, frame = bytes.fromhex("010330010001DACA"), bytes.fromhex("0103021388B512")
    odds = Odds(frame, modbus.forms(sent), modbus.alphabet, 0)
    found = {places: exact(modbus, sent, frame, places) for places in combinations((3, 4, 6), 2)}
    assert any(found.values())
    assert {places: odds.substituted(places) for places in found} == pytest.approx(found)


def test_noise_hits_as_often_as_the_product_of_its_fields_says() -> None:
    """RELIABILITY 4: a DZB100 read answer 2^-71, RTU FC03 of one register 2^-40 and its exceptions."""
    dzb, modbus = ROSTER["dzb100"], ROSTER["modbus-rtu"]
    (size, done), (_, refused) = noise(dzb.forms(bytes.fromhex("5203013033323330303030")))
    assert (size, done + refused) == (11, pytest.approx(2.0**-71))
    chances = dict(noise(modbus.forms(bytes.fromhex("010330010001DACA"))))
    assert chances == {7: pytest.approx(2.0**-40), 5: pytest.approx(10 * 2.0**-40)}


@every_entry
def test_garbled_ends_hit_as_often_as_reckoned(entry: Entry) -> None:
    rng, taken_ones, expected = Random(7), 0, 0.0
    for _ in range(10):
        exchange = entry.talk(rng, entry.codec)
        target, _ = garbage.targets(entry, exchange)
        base = Base(exchange.received, exchange.sent, entry.alphabet, entry.judge.marks, entry.judge.seal)
        for _ in range(100):
            data, places = KINDS["garbled"](rng, base)
            expected += target.odds.garbled(places[0])
            taken_ones += data != exchange.received and entry.judge.size(exchange.sent, data) is not None
    assert taken_ones <= limit(expected)


def test_a_form_that_is_shorter_than_the_frame_counts_too() -> None:
    form = Form((frozenset(b"a"), frozenset(b"b")), range(0), "none")
    assert Odds(b"axy", (form,), b"bc", 0).garbled(1) == 0.5
    assert Odds(b"axy", (form,), b"bc", 0).substituted((1,)) == pytest.approx(1 / 255)


# -- cost ----------------------------------------------------------------------------------------------------------


def steps(decode: Callable[[bytes], object], data: bytes) -> int:
    """Lines of Python that a decoder runs."""
    count = 0

    def trace(frame: FrameType, event: str, arg: object) -> Any:
        nonlocal count
        count += event == "line"
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        outcome(decode, data)
    finally:
        sys.settrace(before)
    return count


@every_entry
def test_g02_the_steps_that_garbage_costs_grow_with_its_length_and_no_faster(entry: Entry) -> None:
    rng = Random(3)
    for decode in cost.sides(rng, entry):
        for data in cost.garbage(rng, entry):
            for size in (16, 64, 256):
                assert steps(decode, data[:size]) <= 10 * size + 100
