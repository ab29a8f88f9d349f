"""The fuzz targets keep the contract of the codecs, and a decoder that violates it is found."""

from __future__ import annotations

import importlib.util
import json
import random
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from drivebus.errors import CodeError, ProtocolError
from drivebus.protocols.codec import Complete, CompleteIfSilent, DecodeResult, Incomplete
from verification.atheris_fuzz.targets import ATHERIS_TARGETS, SEALED_CHOICE, ContractViolation, check_decoder

REPORT = Path(__file__).resolve().parents[2] / "docs" / "reports" / "atheris.json"


@pytest.mark.parametrize("name", ATHERIS_TARGETS)
def test_seeds_and_seeds_with_one_changed_byte_keep_the_contract(name: str) -> None:
    rng, target = random.Random(1), ATHERIS_TARGETS[name]
    for seed in target.seeds():
        target.run_input(seed)
        data = bytearray(seed)
        data[rng.randrange(len(data))] = rng.randrange(256)
        data[0] |= SEALED_CHOICE * rng.randrange(2)
        target.run_input(bytes(data))


@pytest.mark.parametrize("name", ATHERIS_TARGETS)
def test_sealed_inputs_pass_the_check(name: str) -> None:
    """Otherwise the fuzzer would only reach the rejection of a wrong checksum."""
    rng, target, read = random.Random(2), ATHERIS_TARGETS[name], 0
    for _ in range(3000):
        body = bytes(rng.choice((0, 0, 1, 1, 2, 3, 6, 16)) for _ in range(rng.randrange(3, 13)))
        try:
            read += isinstance(target.codec.decode_request(target.seal(body)), Complete)
        except ProtocolError as error:
            read += isinstance(error, CodeError)
    assert read > 5


def scripted_decoder(*verdicts: DecodeResult | Exception) -> Any:
    """Return a decoder with these results for 0, 1, 2 … bytes, and the last one for more."""

    def decode(data: bytes) -> DecodeResult:
        verdict = verdicts[min(len(data), len(verdicts) - 1)]
        if isinstance(verdict, Exception):
            raise verdict
        return verdict

    return decode


FAULTY_DECODERS = [
    scripted_decoder(Incomplete(1), Incomplete(1)),
    scripted_decoder(Incomplete(3), Incomplete(3), Complete("early", 2)),
    scripted_decoder(Incomplete(1), Incomplete(2), Complete("longer than it is", 3)),
    scripted_decoder(Incomplete(1), Incomplete(2), Complete("nothing", 0)),
    scripted_decoder(Incomplete(1), CompleteIfSilent("a", 1, 1)),
    scripted_decoder(Incomplete(1), Incomplete(2), Complete("a", 1), Complete("b", 1)),
]


@pytest.mark.parametrize("decode", FAULTY_DECODERS)
def test_a_decoder_that_violates_the_contract_is_found(decode: Any) -> None:
    with pytest.raises(ContractViolation):
        check_decoder(decode, b"\x01\x02\x03")


def test_an_unexpected_error_is_not_hidden() -> None:
    with pytest.raises(IndexError):
        check_decoder(scripted_decoder(Incomplete(1), IndexError()), b"\x01")


def test_a_correct_decoder_passes() -> None:
    check_decoder(
        scripted_decoder(Incomplete(2), Incomplete(2), CompleteIfSilent("a", 2, 3), Complete("b", 3)),
        b"\x01\x02\x03\x04",
    )


@pytest.mark.parametrize("name", ["dzb100"])
def test_a_target_runs_under_atheris(name: str) -> None:
    if importlib.util.find_spec("atheris") is None:
        pytest.skip("atheris is missing: install it with `pip install atheris` (Linux; wheels up to Python 3.13)")
    command = [sys.executable, "-m", "verification.atheris_fuzz.run", name, "-runs=2000", "-seed=1"]
    done = subprocess.run(command, cwd=REPORT.parents[2], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert "Done 2000 runs" in done.stderr


def test_the_committed_report_has_every_decoder_and_no_crash() -> None:
    found = json.loads(REPORT.read_text(encoding="utf-8"))["decoders"]
    assert found.keys() == ATHERIS_TARGETS.keys()
    for name, figures in found.items():
        assert (figures["crashes"], figures["runs"] >= 40_000) == (0, True), name
        assert not figures["commit"].endswith("-dirty") and figures["features"] >= figures["edges"] > 0
