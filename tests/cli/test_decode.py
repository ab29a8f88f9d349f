"""Each worked vector through ``decode --json``: the golden frames of the manuals, as a user would ask about them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from drivebus import i18n
from drivebus.cli.main import cli

VECTORS = [
    json.loads(line)
    for file in sorted((Path(__file__).parents[2] / "vectors").glob("*.jsonl"))
    for line in file.read_text(encoding="utf-8").splitlines()
]
BY_ID = {vector["id"]: vector for vector in VECTORS}


def ask(vector: dict[str, Any], *more: str) -> tuple[int, dict[str, Any]]:
    """Exit code and document of ``decode`` for a vector."""
    words = ["decode", "--json", "--model", vector["model"], "--encoding", vector["encoding"]]
    words += ["--direction", vector["direction"]]
    if "reply_to" in vector:
        words += ["--request", BY_ID[vector["reply_to"]]["hex"]]
    result = CliRunner().invoke(cli, [*words, *more, *vector["hex"].split()])
    return result.exit_code, json.loads(result.stdout)


@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: vector["id"])
def test_each_vector_is_explained_with_its_verdict(vector: dict[str, Any]) -> None:
    code, text = ask(vector)
    decodable = vector.get("decodable", True)
    assert text["valid"] is decodable
    assert code == (0 if decodable else 3)
    assert text["direction"] == vector["direction"]
    assert text["encoding"] == vector["encoding"]
    if decodable:
        found = {name: text["fields"].get(name) for name in vector["fields"]}
        assert found == vector["fields"]
    else:
        assert text["problems"]
    assert bool(text["hazards"]) or "hazard" not in vector
    assert bool(text["errata"]) or "erratum" not in vector
    if "canonical_hex" in vector and decodable:
        assert text["canonical_hex"] == vector["canonical_hex"]


@pytest.mark.parametrize("language", ["en", "zh"])
@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: vector["id"])
def test_each_vector_is_explained_for_people_in_both_languages(vector: dict[str, Any], language: str) -> None:
    words = ["decode", "--model", vector["model"], "--encoding", vector["encoding"], "--lang", language]
    result = CliRunner().invoke(cli, [*words, "--direction", vector["direction"], *vector["hex"].split()])
    assert result.exit_code in (0, 3)
    assert vector["hex"] in result.output
    assert "decode." not in result.output


def names_in(fields: Any) -> set[str]:
    """Names of fields, of those inside fields too; codings are names by themselves."""
    if isinstance(fields, list):
        return set().union(*map(names_in, fields))
    if not isinstance(fields, dict):
        return set()
    inside = [names_in(each) for name, each in fields.items() if name != "frequency_hz_by_coding"]
    return set(fields).union(*inside)


@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: vector["id"])
def test_each_field_has_a_name_for_people(vector: dict[str, Any]) -> None:
    text = ask(vector)[1]
    for fields in (text["fields"], *(one["fields"] for one in text["interpretations"])):
        assert {name for name in names_in(fields) if f"decode.field.{name}" not in i18n.catalogue("zh")} == set()


@pytest.mark.parametrize("text", [":010600F9", ": 01 06 00 F9", "3A 30 31 30 36 30 30 46 39 0D 0A"])
def test_a_frame_may_be_given_as_the_manual_prints_it(text: str) -> None:
    """DF800's own error form, as characters: Modbus ASCII, not RTU bytes without their CRC."""
    result = CliRunner().invoke(cli, ["decode", "--model", "df800", "--json", *text.split()])
    reply_text = json.loads(result.output)
    assert (result.exit_code, reply_text["encoding"], reply_text["fields"]["error"]) == (0, "ascii", True)


def test_a_colon_between_pairs_is_no_modbus_frame() -> None:
    result = CliRunner().invoke(cli, ["decode", "--model", "c320", "--json", "2A:30:30"])
    assert json.loads(result.output)["hex"] == "2A 30 30"


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
