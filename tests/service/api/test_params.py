"""Wrong parameters: each is reported with its path and in both languages."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import pytest
from pydantic import BaseModel, ValidationError

from drivebus import i18n
from drivebus.errors import InvalidParameters
from drivebus.service.api.errors import (
    FAULT_MESSAGES,
    error_from_json,
    error_to_json,
    param_fault,
    params_error,
    pydantic_faults,
)
from drivebus.service.api.operations import OPERATIONS
from drivebus.service.api.operations.drives import ParameterWriteParams
from drivebus.service.historian.queries import check_time_order
from drivebus.testing.virtual_time import run
from drivebus.types import Json
from drivebus.web.operations import WEB_OPERATIONS
from fixtures.service import running_service

MODELS: list[type[BaseModel]] = [
    *dict.fromkeys(operation.params for operation in (*OPERATIONS.values(), *WEB_OPERATIONS.values())),
]
FRAMEWORK_FAULTS = {"model_attributes_type"}
"""Fault of FastAPI for JSON that is no object."""
NAMES_OF_PYDANTIC = {"float", "constrained-str", "[key]"}
BAD: list[Any] = [
    None,
    True,
    1,
    1.5,
    10**400,
    -1,
    float("nan"),
    float("inf"),
    "",
    "A B",
    "two\nlines",
    "x" * 300,
    "x" * 1_000_001,
    "\ud800",
    b"x",
    [],
    [1],
    ["x"] * 70,
    {},
    {"x": "y"},
    {"": 1.0},
    {1: 2},
    {"x": float("nan")},
    {str(n): 1.0 for n in range(70)},
]


def faults_of(model: type[BaseModel], value: Any) -> list[Any]:
    try:
        model.model_validate(value)
    except ValidationError as error:
        return error.errors(include_url=False)
    return []


def all_faults() -> Iterator[tuple[Any, Any]]:
    """Yield the faults of each bad value in the place of each model and of each of its fields, with the parameters."""
    for model in MODELS:
        for bad in BAD:
            for params in (bad, *({name: bad} for name in [*model.model_fields, "no_such_field"])):
                for fault in faults_of(model, params):
                    yield fault, params


def described(operation: str, params: Any) -> list[Json]:
    """Return the faults of the parameters of an operation as a client gets them."""
    return pydantic_faults(faults_of(OPERATIONS[operation].params, params), params)


FAULTS = [*all_faults()]


def test_exactly_the_kinds_of_fault_of_the_models_have_a_sentence() -> None:
    kinds = {fault["type"] for fault, _ in FAULTS}
    assert len(kinds) > 15
    assert kinds | FRAMEWORK_FAULTS == FAULT_MESSAGES.keys()
    for key in FAULT_MESSAGES.values():
        assert i18n.known(f"params.{key}")


def test_a_fault_has_its_path_and_a_chinese_text_without_english() -> None:
    for found, params in FAULTS:
        (message,) = pydantic_faults([found], params)
        assert message["path"] == ".".join(str(part) for part in found["loc"] if part not in NAMES_OF_PYDANTIC)
        chinese = message["expected"]["zh"]
        assert any("一" <= letter <= "鿿" for letter in chinese) and "{" not in chinese.replace("{0,63}", "")
        assert found["msg"] not in chinese and not {"should", "expected", "character"} & {*chinese.split()}
        assert "{" not in message["expected"]["en"].replace("{0,63}", "")


@pytest.mark.parametrize(
    ("params", "path", "english", "chinese"),
    [
        ({"drive": "fan-1", "frequency_hz": 1000.5}, "frequency_hz", "expected 1000 or less", "应不大于 1000"),
        ({"drive": "fan-1"}, "frequency_hz", "is required", "必须给出"),
        (
            {"drive": "fan-1", "frequency_hz": 1.0, "direction": "up"},
            "direction",
            "expected one of 'forward', 'reverse'",
            "应为以下之一：'forward'、'reverse'",
        ),
    ],
)
def test_a_wrong_parameter_is_described_in_both_languages(params: Json, path: str, english: str, chinese: str) -> None:
    error = params_error("drive.run", described("drive.run", params))
    message = error_to_json(error)
    assert message["text"] == {"en": f"{path}: {english}", "zh": f"{path}：{chinese}"}
    assert [fault["expected"] for fault in message["params"]["faults"]] == [{"en": english, "zh": chinese}]


def test_several_wrong_parameters_are_joined_with_the_punctuation_of_the_language() -> None:
    faults = described("drive.run", {"frequency_hz": 1.0, "direction": 1})
    text = error_to_json(params_error("drive.run", faults))["text"]
    assert text["en"].startswith("drive: is required; direction: expected ")
    assert text["zh"].startswith("drive：必须给出；direction：应为")


@pytest.mark.parametrize(
    ("values", "path", "english", "chinese"),
    [
        ({"F1": [1]}, "values.F1", "expected a number, or expected text", "应为数值，或应为文本"),
        (
            {"F1": "ten"},
            "values.F1",
            "expected a number, or expected text that fits ^[0-9][0-9A-FXHa-fxh]*$",
            "应为数值，或应为符合 ^[0-9][0-9A-FXHa-fxh]*$ 的文本",
        ),
        ({"": 1}, "values.", "expected at least 1 characters", "应至少 1 个字符"),
        ({"float": []}, "values.float", "expected a number, or expected text", "应为数值，或应为文本"),
    ],
)
def test_a_value_that_may_have_two_types_has_one_sentence_without_words_of_pydantic(
    values: Json, path: str, english: str, chinese: str
) -> None:
    """It was two faults, of ``values.F1.float`` and ``values.F1.constrained-str``."""
    (fault,) = described("parameters.write", {"drive": "fan-1", "values": values})
    assert (fault["path"], fault["expected"]) == (path, {"en": english, "zh": chinese})


def test_a_fault_has_the_exact_bound_and_the_index_in_a_list() -> None:
    bounds = described("history.trend", {"from_ms": 10**15})
    assert {"en": "expected 253402300799999 or less", "zh": "应不大于 253402300799999"} in [
        fault["expected"] for fault in bounds
    ]
    entries = described("history.trend", {"tags": ["a", 1]})
    assert entries[0]["path"] == "tags.1" and entries[0]["found"] == "1"


def test_an_unknown_kind_of_fault_has_a_sentence() -> None:
    message = pydantic_faults([{"type": "of_tomorrow", "loc": ("x",), "msg": "Input should", "input": 1}], {"x": 1})
    assert message == [param_fault("x", "1", "other")] and message[0]["expected"]["zh"] != message[0]["expected"]["en"]


def test_a_fault_found_by_a_handler_is_described_in_both_languages() -> None:
    """The history rejects a time range that ends before it begins; no model can."""
    with pytest.raises(InvalidParameters) as caught:
        check_time_order(5, 4)
    message = error_to_json(params_error("history.trend", caught.value.params["faults"]))["text"]
    assert message["en"] == "to_ms: expected 5 (from_ms) or more"
    assert message["zh"] == "to_ms：应不小于 5（from_ms）"


def test_wrong_parameters_over_the_socket_have_the_same_shape() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            with pytest.raises(InvalidParameters) as caught:
                await kit.call("drive.run", drive="fan-1", frequency_hz="5")
            assert "应为数值" in error_to_json(caught.value)["text"]["zh"]
            assert error_to_json(error_from_json(error_to_json(caught.value))) == error_to_json(caught.value)

    run(scenario())


@pytest.mark.parametrize(("value", "accepted"), [("0010H", True), ("0x10", True), ("0010", True), ("ten", False)])
def test_a_parameter_is_written_as_a_number_or_as_the_word_of_the_manual(value: str, accepted: bool) -> None:
    params = {"drive": "fan-1", "values": {"F1.10": value}}
    if accepted:
        assert ParameterWriteParams.model_validate(params).values == {"F1.10": value}
    else:
        with pytest.raises(ValidationError):
            ParameterWriteParams.model_validate(params)


@pytest.mark.parametrize(
    "reason",
    ["   ", "\u3000\u3000\u3000", "safe\u200f", "\u200b\u200b\u200b", "a\u2060b", "x\x1b[2J", "two\nlines"]
    + ["\xad\xad\xad", "\u3164 \u115f", "\u2800\u2800\u2800", "\ufe0f\u200d\ufe0f"],
)
def test_a_reason_is_visible_text_of_one_line(reason: str) -> None:
    """A waiver without a reason, or with one that shows as another, would explain nothing."""
    for name in ("waiver.grant", "waivers.grant"):
        with pytest.raises(InvalidParameters) as refused:
            OPERATIONS[name].validate({"drive": "fan-1"} | {"reason": reason})
        assert "not blank" in str(refused.value)
    schema = OPERATIONS["waiver.grant"].params.model_json_schema()["properties"]["reason"]
    assert not re.search(schema["pattern"], reason)
    assert re.search(schema["pattern"], " hard-wired stop, 急停 ")


def test_invisible_characters_of_the_higher_planes_are_no_reason() -> None:
    with pytest.raises(InvalidParameters):
        OPERATIONS["waiver.grant"].validate({"drive": "fan-1", "reason": "\U000e0041" * 3})
    OPERATIONS["waiver.grant"].validate({"drive": "fan-1", "reason": "می\u200cخواهم"})  # joins letters: visible text


def replacements(value: Any, text: str) -> Iterator[Any]:
    """Yield the value with one of its texts, or names of an object, replaced."""
    if isinstance(value, str):
        yield text
    elif isinstance(value, list):
        for index, item in enumerate(value):
            yield from ([*value[:index], other, *value[index + 1 :]] for other in replacements(item, text))
    elif isinstance(value, dict):
        for name, member in value.items():
            rest = {key: other for key, other in value.items() if key != name}
            yield rest | {text: member}
            yield from (rest | {name: other} for other in replacements(member, text))


@pytest.mark.parametrize("text", ["a3\nfan-1 done", "a3\x1b[31m", "a3\u202e1-naf", "a3\u200b", "\u3164\u3164\u3164"])
def test_no_text_of_an_audited_operation_has_control_direction_or_only_invisible_characters(text: str) -> None:
    """The words of a client, as an alarm's id or a parameter's name, stand in the audit trail, on page and terminal."""
    audited = [operation for operation in OPERATIONS.values() if operation.mutates]
    assert sum(1 for operation in audited for _ in replacements(operation.example, text)) > 100
    for operation in audited:
        for params in replacements(operation.example, text):
            with pytest.raises(InvalidParameters):
                operation.validate(params)
