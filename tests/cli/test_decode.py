"""``decode --json`` of every worked frame of the manuals."""

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


def decode(vector: dict[str, Any], *more: str) -> tuple[int, dict[str, Any]]:
    """Return the exit code and the JSON document of ``decode`` for a vector."""
    words = ["decode", "--json", "--model", vector["model"], "--encoding", vector["encoding"]]
    words += ["--direction", vector["direction"]]
    if "reply_to" in vector:
        words += ["--request", BY_ID[vector["reply_to"]]["hex"]]
    result = CliRunner().invoke(cli, [*words, *more, *vector["hex"].split()])
    return result.exit_code, json.loads(result.stdout)


@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: vector["id"])
def test_each_vector_has_its_fields_and_verdict(vector: dict[str, Any]) -> None:
    code, document = decode(vector)
    decodable = vector.get("decodable", True)
    assert document["valid"] is decodable
    assert code == (0 if decodable else 3)
    assert document["direction"] == vector["direction"]
    assert document["encoding"] == vector["encoding"]
    if decodable:
        found = {name: document["fields"].get(name) for name in vector["fields"]}
        assert found == vector["fields"]
    else:
        assert document["problems"]
    assert bool(document["hazards"]) or "hazard" not in vector
    assert bool(document["errata"]) or "erratum" not in vector
    if "canonical_hex" in vector and decodable:
        assert document["canonical_hex"] == vector["canonical_hex"]


@pytest.mark.parametrize("language", ["en", "zh"])
@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: vector["id"])
def test_the_text_of_each_vector_is_in_the_users_language(vector: dict[str, Any], language: str) -> None:
    words = ["decode", "--model", vector["model"], "--encoding", vector["encoding"], "--lang", language]
    result = CliRunner().invoke(cli, [*words, "--direction", vector["direction"], *vector["hex"].split()])
    assert result.exit_code in (0, 3)
    assert vector["hex"] in result.output
    assert "decode." not in result.output


def names_in(fields: Any) -> set[str]:
    """Return the names of fields and nested fields; the names of codings are not fields."""
    if isinstance(fields, list):
        return set().union(*map(names_in, fields))
    if not isinstance(fields, dict):
        return set()
    nested = [names_in(each) for name, each in fields.items() if name != "frequency_hz_by_coding"]
    return set(fields).union(*nested)


@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: vector["id"])
def test_each_field_has_a_label(vector: dict[str, Any]) -> None:
    document = decode(vector)[1]
    for fields in (document["fields"], *(interpretation["fields"] for interpretation in document["interpretations"])):
        assert {name for name in names_in(fields) if f"decode.field.{name}" not in i18n.catalogue("zh")} == set()


@pytest.mark.parametrize("text", [":010600F9", ": 01 06 00 F9", "3A 30 31 30 36 30 30 46 39 0D 0A"])
def test_a_modbus_ascii_frame_can_be_given_as_characters(text: str) -> None:
    """The error form of the DF800 is Modbus ASCII, not RTU bytes without their CRC."""
    result = CliRunner().invoke(cli, ["decode", "--model", "df800", "--json", *text.split()])
    document = json.loads(result.output)
    assert (result.exit_code, document["encoding"], document["fields"]["error"]) == (0, "ascii", True)


def test_colons_between_pairs_are_separators() -> None:
    result = CliRunner().invoke(cli, ["decode", "--model", "c320", "--json", "2A:30:30"])
    assert json.loads(result.output)["hex"] == "2A 30 30"


def test_hexadecimal_digits_with_and_without_blanks_are_the_same_frame() -> None:
    vector = BY_ID["vc660-loopback"]
    joined = dict(vector, hex=vector["hex"].replace(" ", "").lower())
    assert decode(vector)[1]["fields"] == decode(joined)[1]["fields"]


@pytest.mark.parametrize("text", ["2", "2G", "+1 02", "0x2", "１２"])
def test_an_invalid_hexadecimal_digit_is_a_usage_error(text: str) -> None:
    result = CliRunner().invoke(cli, ["decode", "--model", "c320", "--", text])
    assert result.exit_code == 2
    assert text in result.output


def test_an_unknown_model_is_a_configuration_error() -> None:
    result = CliRunner().invoke(cli, ["decode", "--model", "c321", "2A"])
    assert result.exit_code == 2


@pytest.mark.parametrize("language", ["en", "zh"])
def test_the_label_of_a_fault_whose_text_has_it_stands_once(language: str) -> None:
    """A C320 in fault had *fault  Fu.5* above *fault is  fault Fu.5: see the fault table of the C320 manual*."""
    words = ("--model", "c320", "2A 30 33 30 32 30 30 30 35 30 30 30 30 30 32 34 41 0D", "--lang", language)
    assert CliRunner().invoke(cli, ["decode", *words]).stdout.count("Fu.5") == 1
    assert json.loads(CliRunner().invoke(cli, ["decode", *words, "--json"]).stdout)["fields"]["fault"] == "Fu.5"
    e009 = ("--model", "dzb100", "51 03 06 30 31 30 33 30 30 30 31", "--lang", language)
    assert "E009" in CliRunner().invoke(cli, ["decode", *e009]).stdout
