"""Each worked vector through ``decode --json``: the golden frames of the manuals, as a user would ask about them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from drivebus.cli.root import cli

VECTORS = [
    json.loads(line)
    for file in sorted((Path(__file__).parents[2] / "vectors").glob("*.jsonl"))
    for line in file.read_text(encoding="utf-8").splitlines()
]
BY_ID = {vector["id"]: vector for vector in VECTORS}


def ask(vector: dict[str, Any], *more: str) -> tuple[int, dict[str, Any]]:
    """Exit code and document of ``decode`` for a vector."""
    words = ["decode", "--json", "--model", vector["family"], "--encoding", vector["encoding"]]
    words += ["--direction", vector["direction"]]
    if "reply_to" in vector:
        words += ["--request", BY_ID[vector["reply_to"]]["hex"]]
    result = CliRunner().invoke(cli, [*words, *more, *vector["hex"].split()])
    return result.exit_code, json.loads(result.stdout)


@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: vector["id"])
def test_each_vector_is_explained_with_its_verdict(vector: dict[str, Any]) -> None:
    code, said = ask(vector)
    decodable = vector.get("decodable", True)
    assert said["valid"] is decodable
    assert code == (0 if decodable else 3)
    assert said["direction"] == vector["direction"]
    assert said["encoding"] == vector["encoding"]
    if decodable:
        found = {name: said["fields"].get(name) for name in vector["fields"]}
        assert found == vector["fields"]
    else:
        assert said["problems"]
    assert bool(said["hazards"]) or "hazard" not in vector
    assert bool(said["errata"]) or "erratum" not in vector
    if "canonical_hex" in vector and decodable:
        assert said["canonical_hex"] == vector["canonical_hex"]


@pytest.mark.parametrize("language", ["en", "zh"])
@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: vector["id"])
def test_each_vector_is_explained_for_people_in_both_languages(vector: dict[str, Any], language: str) -> None:
    words = ["decode", "--model", vector["family"], "--encoding", vector["encoding"], "--lang", language]
    result = CliRunner().invoke(cli, [*words, "--direction", vector["direction"], *vector["hex"].split()])
    assert result.exit_code in (0, 3)
    assert vector["hex"] in result.output


def test_hexadecimal_digits_may_be_written_with_and_without_blanks() -> None:
    vector = BY_ID["vc660-loopback"]
    glued = dict(vector, hex=vector["hex"].replace(" ", "").lower())
    assert ask(vector)[1]["fields"] == ask(glued)[1]["fields"]


@pytest.mark.parametrize("text", ["2", "2G", "+1 02", "0x2", "１２"])
def test_what_is_no_hexadecimal_digit_is_refused_as_usage(text: str) -> None:
    result = CliRunner().invoke(cli, ["decode", "--model", "c320", "--", text])
    assert result.exit_code == 2
    assert text in result.output


def test_an_unknown_model_is_refused_as_configuration() -> None:
    result = CliRunner().invoke(cli, ["decode", "--model", "c321", "2A"])
    assert result.exit_code == 2
