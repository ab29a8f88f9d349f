"""The accepted damaged frames are the recorded ones; under a CRC-16 there are none."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from math import comb
from pathlib import Path
from typing import Any

import pytest

from drivebus.protocols.sunfar import frame as sunfar_frame
from verification.campaign import CampaignRun
from verification.campaigns import flips
from verification.codec_fuzz import bit_flips
from verification.codec_fuzz.bit_flips import FLIP_COUNTS, FlipCase
from verification.families.campaigns import FUZZED_CODECS
from verification.reference.modbus import reference_crc

VECTORS = Path(__file__).parents[2] / "vectors"


@pytest.fixture
def no_table(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bit_flips, "undetected_shares", lambda most: {})


def campaign(budget: int, seed: int = 1) -> CampaignRun:
    campaign_run = CampaignRun(campaign="flips", seed=seed, budget=budget)
    flips.run(campaign_run)
    return campaign_run


def test_every_vector_is_recorded_with_every_receiver() -> None:
    assert set(bit_flips.vector_cases(VECTORS)) == set(bit_flips.recorded_cases())


def test_no_flip_of_three_bits_passes_a_crc() -> None:
    """Every frame that is valid as printed is checked; the misprinted one is three bits from its correct form."""
    for case, sets in bit_flips.recorded_cases().items():
        if case.codec.endswith("rtu") and reference_crc(case.frame) == 0:
            assert [sets[str(bits)]["accepted"] for bits in FLIP_COUNTS] == [0, 0, 0], case.name
    (misprint,) = (c for c in bit_flips.recorded_cases() if c.vector == "vc660-read-f00-response" and c.printed)
    assert "3.4 3.6 3.7" in bit_flips.recorded_cases()[misprint]["3"]["flips"]


def test_no_single_flip_passes_a_sum_read_strictly() -> None:
    strict = ("c320-ascii", "c320-hex", "df800-ascii")
    found = {
        case.name for case, sets in bit_flips.recorded_cases().items() if case.codec in strict and sets["1"]["accepted"]
    }
    assert not found


def test_t11_every_accepted_single_flip_of_the_dzb100_is_recorded() -> None:
    """No check detects a flip in B or in the data of a read reply."""
    (read,) = (case for case in bit_flips.recorded_cases() if case.vector == "dzb100-3-response")
    listed = bit_flips.recorded_cases()[read]["1"]
    assert listed["accepted"] == len(listed["flips"]) == 15
    assert {flip.split(".")[0] for flip in listed["flips"]} == {"2", "7", "8", "9", "10"}


def test_the_campaign_keeps_its_budget_and_is_reproducible(no_table: None) -> None:
    first, second = campaign(9_000), campaign(9_000)
    assert not first.violations
    assert first.digest == second.digest
    assert 9_000 <= first.trials < 9_200
    assert first.figures["cases"] > 50


def test_a_sum_that_is_not_compared_is_found(no_table: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sunfar_frame, "_check_checksum", lambda frame, found: None)
    assert any("codec and reference disagree" in text for text in campaign(300).violations)


def test_a_set_that_differs_from_the_record_is_found(no_table: None, monkeypatch: pytest.MonkeyPatch) -> None:
    case, sets = next((c, s) for c, s in bit_flips.recorded_cases().items() if c.vector == "dzb100-3-response")
    other = sets | {"1": sets["1"] | {"flips": [*sets["1"]["flips"][:-1], "0.0"]}}
    monkeypatch.setattr(bit_flips, "recorded_cases", lambda: {case: other})
    assert [text for text in campaign(88).violations if "recorded" in text]


def test_a_flip_that_passes_a_crc_is_found(no_table: None) -> None:
    campaign_run = CampaignRun(campaign="flips", seed=1, budget=1)
    case = next(c for c in bit_flips.recorded_cases() if c.vector == "vc660-stop" and c.role == "request")
    flips._compare_with_record(campaign_run, case, 1, ["0.0"], [])
    assert any("pass a CRC-16" in text for text in campaign_run.violations)


def test_a_case_is_tried_with_every_pattern() -> None:
    """Every pattern is tried once."""
    case = FlipCase(
        vector="x",
        printed=True,
        role="request",
        codec="dzb100",
        sent=b"",
        frame=bytes.fromhex("4303013030303030303030"),
    )
    found, disputed = bit_flips.accepted_flips(case, 1)
    assert not disputed
    reference = FUZZED_CODECS["dzb100"].reference
    assert found == [flip for flip, data in single_flips(case.frame) if reference.accepted_size(b"", data)]
    assert case.pattern_count(3) == comb(88, 3)


def single_flips(frame: bytes) -> Iterator[tuple[str, bytes]]:
    for place in range(len(frame)):
        for bit in range(8):
            yield f"{place}.{bit}", frame[:place] + bytes((frame[place] ^ 1 << bit,)) + frame[place + 1 :]


def test_few_flips_are_listed_and_many_are_hashed() -> None:
    few, many = [f"0.{n}" for n in range(20)], [f"0.{n}" for n in range(21)]
    assert bit_flips.flips_digest(few) == {"accepted": 20, "flips": few}
    assert bit_flips.flips_digest(many).keys() == {"accepted", "sha256"}
    assert bit_flips.flips_digest(many) != bit_flips.flips_digest(many[:-1] + ["1.0"])


# -- the table -----------------------------------------------------------------------------------------------------


def test_parity_leaves_the_patterns_that_are_even_in_every_character() -> None:
    """Compared with all patterns over the nine bits of three characters."""
    for bits in (2, 4):
        masks: list[Any] = []
        for places in combinations(range(27), bits):
            per_character = [[place % 9 for place in places if place // 9 == n] for n in range(3)]
            if all(len(flipped) % 2 == 0 for flipped in per_character):
                data = [(n, sum(1 << b for b in flipped) & 255) for n, flipped in enumerate(per_character) if flipped]
                masks.append(tuple(data))
        assert sorted(bit_flips._parity_preserving_patterns(b"abc", bits)) == sorted(masks)


def test_the_table_shows_what_each_check_lets_through() -> None:
    table: Any = bit_flips.undetected_shares(2)
    without_check = {"DZB100", "Mitsubishi, acknowledgement"}
    assert {name for name, row in table.items() if row["check_1_bit"]["passed"]} == without_check
    assert table["Mitsubishi, acknowledgement"]["echo_2_bit"]["passed"] == 0  # it repeats the station
    assert table["Mitsubishi, read of four digits"]["echo_2_bit"]["passed"] == 18
    for name in ("Modbus RTU, 03, one register", "Modbus RTU, 06"):
        assert not any(row["passed"] for row in table[name].values() if isinstance(row, dict))
    assert table["C320 ASCII"]["check_2_bit"]["share"] == pytest.approx(0.0103)
    assert table["Modbus ASCII, 06"]["check_2_bit"]["share"] == pytest.approx(0.006, rel=0.01)
    assert table["Modbus ASCII, 06"]["echo_2_bit"]["passed"] == 0
    assert table["DZB100"]["echo_1_bit"]["passed"] == 15
    for name, row in table.items():
        for bits in (1, 2):
            assert row[f"echo_{bits}_bit"]["passed"] <= row[f"check_{bits}_bit"]["passed"]
        assert row["check_2_bit_parity"]["passed"] == 0 or name in without_check


def test_every_row_of_the_table_is_a_valid_reply() -> None:
    for row in bit_flips.STRENGTH_CASES:
        sent, frame = bytes.fromhex(row.sent), bytes.fromhex(row.frame)
        entry = FUZZED_CODECS[row.codec]
        assert entry.codec.decode_reply(entry.request_of(sent), frame).size == len(frame)  # type: ignore[union-attr]
        assert entry.reference.is_well_formed(frame)
